# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The register file behind the camera's vendor requests: what can be read, written and counted.

Module and parameter numbers, read-only values and power-up defaults are those of a DAVIS346 on an
FX3 board with FPGA logic 18.1, as the libcaer sources document them. Values are unsigned 32 bit;
statistics are 64 bit, upper half at the first parameter, lower half at the next one. Capability
bits of what is not modelled (background activity, refractory and skip filters) read 0, and hosts
then leave these blocks alone.

The numbers are written down here again, and never imported from the driver: they are its oracle.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from types import MappingProxyType
from typing import Final

from mixtac_sim.grids import HEIGHT, WIDTH

_MASK = 0xFFFFFFFF


class Module(IntEnum):
    """Configuration modules of the FPGA."""

    MUX = 0
    DVS = 1
    APS = 2
    IMU = 3
    BIAS = 5
    SYSINFO = 6
    USB = 9


class Mux(IntEnum):
    """Parameters of the stream multiplexer."""

    RUN = 0
    TIMESTAMP_RUN = 1
    TIMESTAMP_RESET = 2
    RUN_CHIP = 3
    DROP_DVS_ON_TRANSFER_STALL = 5
    HAS_STATISTICS = 80
    DVS_DROPPED = 83


class Dvs(IntEnum):
    """Parameters of the event readout."""

    SIZE_COLUMNS = 0
    SIZE_ROWS = 1
    ORIENTATION = 2
    RUN = 3
    HAS_PIXEL_FILTER = 10
    FIRST_PIXEL_ROW = 11
    HAS_ROI = 40
    ROI_START_COLUMN = 41
    ROI_START_ROW = 42
    ROI_END_COLUMN = 43
    ROI_END_ROW = 44
    HAS_POLARITY = 60
    FLATTEN = 61
    SUPPRESS = 62
    SUPPRESS_TYPE = 63
    HAS_STATISTICS = 80
    ROW_EVENTS = 81
    COLUMN_EVENTS = 83
    DROPPED = 85
    FILTERED_PIXELS = 87


class Aps(IntEnum):
    """Parameters of the frame readout."""

    SIZE_COLUMNS = 0
    SIZE_ROWS = 1
    ORIENTATION = 2
    RUN = 4
    HAS_GLOBAL_SHUTTER = 6
    GLOBAL_SHUTTER = 7
    START_COLUMN = 8
    START_ROW = 9
    END_COLUMN = 10
    END_ROW = 11
    EXPOSURE = 12
    FRAME_INTERVAL = 13


class Imu(IntEnum):
    """Parameters of the inertial sensor."""

    TYPE = 0
    RUN_ACCEL = 2
    RUN_GYRO = 3
    RUN_TEMPERATURE = 4
    SAMPLE_RATE_DIVIDER = 5
    ACCEL_FULL_SCALE = 7
    GYRO_FULL_SCALE = 10


class Usb(IntEnum):
    """Parameters of the data path to the host."""

    RUN = 0
    EARLY_PACKET_DELAY = 1


ADC_MHZ: Final = 30
"""Nominal ADC clock [MHz]."""
USB_MHZ: Final = 80
"""Nominal USB clock [MHz]."""
CLOCK_DEVIATION: Final = 1008
"""True clocks over nominal ones, in 1/1000."""


def adc_cycles_to_us(cycles: int) -> int:
    """Convert exposure and interval registers to microseconds, rounded."""
    return round(cycles * 1000 / (ADC_MHZ * CLOCK_DEVIATION))


def us_to_adc_cycles(us: int) -> int:
    """Convert microseconds to ADC cycles, rounded."""
    return round(us * ADC_MHZ * CLOCK_DEVIATION / 1000)


# The retail chip is read out sideways: rows of the wire are columns of the picture.
_READ_ONLY: Final[Mapping[tuple[int, int], int]] = MappingProxyType(
    {
        # Logic version, chip, master, clocks of logic, ADC and USB and their deviation, patch.
        **{
            (Module.SYSINFO, param): value
            for param, value in enumerate((18, 5, 1, 120, ADC_MHZ, USB_MHZ, CLOCK_DEVIATION, 1))
        },
        (Module.MUX, Mux.HAS_STATISTICS): 1,
        (Module.DVS, Dvs.SIZE_COLUMNS): HEIGHT,
        (Module.DVS, Dvs.SIZE_ROWS): WIDTH,
        (Module.DVS, Dvs.ORIENTATION): 4,
        (Module.DVS, Dvs.HAS_PIXEL_FILTER): 1,
        (Module.DVS, Dvs.HAS_ROI): 1,
        (Module.DVS, Dvs.HAS_POLARITY): 1,
        (Module.DVS, Dvs.HAS_STATISTICS): 1,
        (Module.APS, Aps.SIZE_COLUMNS): HEIGHT,
        (Module.APS, Aps.SIZE_ROWS): WIDTH,
        (Module.APS, Aps.ORIENTATION): 4,
        (Module.APS, Aps.HAS_GLOBAL_SHUTTER): 1,
        (Module.IMU, Imu.TYPE): 2,
    }
)
_POWER_UP: Final[Mapping[tuple[int, int], int]] = MappingProxyType(
    {
        (Module.DVS, Dvs.ROI_END_COLUMN): WIDTH - 1,
        (Module.DVS, Dvs.ROI_END_ROW): HEIGHT - 1,
        (Module.APS, Aps.GLOBAL_SHUTTER): 1,
        (Module.APS, Aps.END_COLUMN): WIDTH - 1,
        (Module.APS, Aps.END_ROW): HEIGHT - 1,
        (Module.APS, Aps.EXPOSURE): us_to_adc_cycles(4000),
        (Module.APS, Aps.FRAME_INTERVAL): us_to_adc_cycles(40_000),
        (Module.IMU, Imu.ACCEL_FULL_SCALE): 1,
        (Module.IMU, Imu.GYRO_FULL_SCALE): 1,
        (Module.USB, Usb.EARLY_PACKET_DELAY): USB_MHZ * CLOCK_DEVIATION,
        **{(Module.DVS, Dvs.FIRST_PIXEL_ROW + k): (HEIGHT, WIDTH)[k % 2] for k in range(16)},
    }
)
_STATISTICS: Final = (
    (Module.MUX, Mux.DVS_DROPPED),
    (Module.DVS, Dvs.ROW_EVENTS),
    (Module.DVS, Dvs.COLUMN_EVENTS),
    (Module.DVS, Dvs.DROPPED),
    (Module.DVS, Dvs.FILTERED_PIXELS),
)


class RegisterFile:
    """Values of all registers; unknown ones read 0 until they are written.

    Attributes:
        counts: 64-bit statistics by module and first parameter; hosts cannot write them.
    """

    def __init__(self) -> None:
        self.counts: dict[tuple[int, int], int] = dict.fromkeys(_STATISTICS, 0)
        self._values = {**_POWER_UP, **_READ_ONLY}

    def read(self, module: int, param: int) -> int:
        """Return a value."""
        for first, shift in ((param, 32), (param - 1, 0)):
            if (module, first) in self.counts:
                return self.counts[module, first] >> shift & _MASK
        return self._values.get((module, param), 0)

    def write(self, module: int, param: int, value: int) -> None:
        """Write 32 bits; read-only registers stay as they are."""
        if (module, param) not in _READ_ONLY:
            self._values[module, param] = value & _MASK
