# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the synchronisation connector: edge detector and pulse generator."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_driver.configuration import MAXIMUM_PULSE_US
from mixtac_driver.parameter_fields import number, switch


@dataclass(frozen=True)
class ExternalParameters:
    """Synchronisation connector: all of it may change while the node runs."""

    external_input_enabled: bool = switch(True, 'Detector of the input on')
    external_input_rising: bool = switch(False, 'It reports rising edges')
    external_input_falling: bool = switch(False, 'It reports falling edges')
    external_input_pulses: bool = switch(True, 'It reports pulses')
    external_input_pulse_polarity: bool = switch(True, 'Level of a pulse: true high, false low')
    external_input_pulse_length: int = number(
        10, 'Shortest pulse', MAXIMUM_PULSE_US, 'us', minimum=1
    )
    generator_enabled: bool = switch(False, 'Pulse generator at the output on')
    generator_polarity: bool = switch(True, 'Level of its pulses: true high, false low')
    generator_interval: int = number(
        10, 'Time from pulse to pulse', MAXIMUM_PULSE_US, 'us', minimum=2
    )
    generator_length: int = number(
        5, 'Length of its pulses, less than the interval', MAXIMUM_PULSE_US, 'us', minimum=1
    )
    generator_inject_on_rising: bool = switch(False, 'It reports its own rising edges')
    generator_inject_on_falling: bool = switch(False, 'It reports its own falling edges')
