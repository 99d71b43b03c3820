# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the chip's test structures."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_driver.parameter_fields import number, switch
from mixtac_driver.registers import Chip

REGISTERS = {
    'chip_digital_mux_0': Chip.DIGITAL_MUX_0,
    'chip_digital_mux_1': Chip.DIGITAL_MUX_1,
    'chip_digital_mux_2': Chip.DIGITAL_MUX_2,
    'chip_digital_mux_3': Chip.DIGITAL_MUX_3,
    'chip_analog_mux_0': Chip.ANALOG_MUX_0,
    'chip_analog_mux_1': Chip.ANALOG_MUX_1,
    'chip_analog_mux_2': Chip.ANALOG_MUX_2,
    'chip_bias_mux_0': Chip.BIAS_MUX_0,
    'chip_reset_calibration_neuron': Chip.RESET_CALIBRATION_NEURON,
    'chip_type_n_calibration_neuron': Chip.TYPE_N_CALIBRATION_NEURON,
    'chip_reset_test_pixel': Chip.RESET_TEST_PIXEL,
    'chip_aer_na_row': Chip.AER_NAROW,
    'chip_use_a_out': Chip.USE_A_OUT,
    'chip_select_gray_counter': Chip.SELECT_GRAY_COUNTER,
    'chip_test_adc': Chip.TEST_ADC,
}
"""Parameter names and their registers; Chip.GLOBAL_SHUTTER follows aps_global_shutter."""


@dataclass(frozen=True)
class ChipParameters:
    """For measurements on the chip itself: leave them alone unless you have its data sheet."""

    chip_digital_mux_0: int = number(0, 'Signal on the digital test pin 0', 15)
    chip_digital_mux_1: int = number(0, 'Signal on the digital test pin 1', 15)
    chip_digital_mux_2: int = number(0, 'Signal on the digital test pin 2', 15)
    chip_digital_mux_3: int = number(0, 'Signal on the digital test pin 3', 15)
    chip_analog_mux_0: int = number(0, 'Signal on the analogue test pin 0', 15)
    chip_analog_mux_1: int = number(0, 'Signal on the analogue test pin 1', 15)
    chip_analog_mux_2: int = number(0, 'Signal on the analogue test pin 2', 15)
    chip_bias_mux_0: int = number(0, 'Bias on the bias test pin', 15)
    chip_reset_calibration_neuron: bool = switch(True, 'Holds the calibration neuron in reset')
    chip_type_n_calibration_neuron: bool = switch(
        False, 'Calibration neuron measures N-type biases'
    )
    chip_reset_test_pixel: bool = switch(True, 'Holds the test pixel in reset')
    chip_aer_na_row: bool = switch(False, 'Other arbitration of the event rows (nArow)')
    chip_use_a_out: bool = switch(
        False, 'Frames through the analogue output pad instead of the on-chip ADC'
    )
    chip_select_gray_counter: bool = switch(True, 'On-chip ADC counts in Gray code')
    chip_test_adc: bool = switch(False, 'On-chip ADC measures AdcTestVoltage')


def chip_registers(p: ChipParameters) -> dict[Chip, int]:
    """Return the register values that parameters stand for."""
    return {register: int(getattr(p, name)) for name, register in REGISTERS.items()}
