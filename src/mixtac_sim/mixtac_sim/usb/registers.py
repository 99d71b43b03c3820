# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The register file behind the camera's vendor requests: what can be read, written and counted.

Module and parameter numbers, read-only values and power-up defaults are those of a DAVIS346 on an
FX3 board with FPGA logic 18.1, as the libcaer sources document them. Values are unsigned 32 bit;
statistics are 64 bit, upper half at the first parameter, lower half at the next one.

The numbers are written down here again, and never imported from the driver: they are its oracle.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import IntEnum

from mixtac_sim.grids import HEIGHT, WIDTH

_MASK = 0xFFFFFFFF


class Module(IntEnum):
    """Configuration modules of the FPGA."""

    MUX = 0
    DVS = 1
    APS = 2
    IMU = 3
    EXTINPUT = 4
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
    HAS_BA_FILTER = 30
    HAS_ROI = 40
    ROI_START_COLUMN = 41
    ROI_START_ROW = 42
    ROI_END_COLUMN = 43
    ROI_END_ROW = 44
    HAS_SKIP = 50
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
    COLOR_FILTER = 3
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
    ORIENTATION = 1
    RUN_ACCEL = 2
    RUN_GYRO = 3
    RUN_TEMPERATURE = 4
    SAMPLE_RATE_DIVIDER = 5
    ACCEL_FULL_SCALE = 7
    GYRO_FULL_SCALE = 10


class SysInfo(IntEnum):
    """Parameters that describe the board."""

    LOGIC_VERSION = 0
    CHIP = 1
    IS_MASTER = 2
    LOGIC_CLOCK = 3
    ADC_CLOCK = 4
    USB_CLOCK = 5
    CLOCK_DEVIATION = 6
    LOGIC_PATCH = 7


class Usb(IntEnum):
    """Parameters of the data path to the host."""

    RUN = 0
    EARLY_PACKET_DELAY = 1


@dataclass(frozen=True, slots=True)
class Board:
    """Fixed properties of a production run of cameras.

    Attributes:
        dvs_inverted: Events carry x in row words and y in column words (the retail chip does).
        aps_orientation: Bit 2 axes inverted, bit 1 columns and bit 0 rows sent in reverse.
        adc_mhz: Nominal ADC clock [MHz].
        usb_mhz: Nominal USB clock [MHz].
        logic_mhz: Nominal logic clock [MHz].
        deviation: True clock over nominal clock, in 1/1000.
    """

    dvs_inverted: bool = True
    aps_orientation: int = 4
    adc_mhz: int = 30
    usb_mhz: int = 80
    logic_mhz: int = 120
    deviation: int = 1008

    @property
    def aps_inverted(self) -> bool:
        """Whether a readout column of a frame is a row of the picture."""
        return bool(self.aps_orientation & 4)

    def adc_cycles_to_us(self, cycles: int) -> int:
        """Convert exposure and interval registers to microseconds, rounded."""
        return round(cycles * 1000 / (self.adc_mhz * self.deviation))

    def us_to_adc_cycles(self, us: int) -> int:
        """Convert microseconds to ADC cycles, rounded."""
        return round(us * self.adc_mhz * self.deviation / 1000)


def _read_only(board: Board) -> dict[tuple[int, int], int]:
    dvs_size = (HEIGHT, WIDTH) if board.dvs_inverted else (WIDTH, HEIGHT)
    aps_size = (HEIGHT, WIDTH) if board.aps_inverted else (WIDTH, HEIGHT)
    return {
        (Module.SYSINFO, SysInfo.LOGIC_VERSION): 18,
        (Module.SYSINFO, SysInfo.CHIP): 5,
        (Module.SYSINFO, SysInfo.IS_MASTER): 1,
        (Module.SYSINFO, SysInfo.LOGIC_CLOCK): board.logic_mhz,
        (Module.SYSINFO, SysInfo.ADC_CLOCK): board.adc_mhz,
        (Module.SYSINFO, SysInfo.USB_CLOCK): board.usb_mhz,
        (Module.SYSINFO, SysInfo.CLOCK_DEVIATION): board.deviation,
        (Module.SYSINFO, SysInfo.LOGIC_PATCH): 1,
        (Module.MUX, Mux.HAS_STATISTICS): 1,
        (Module.DVS, Dvs.SIZE_COLUMNS): dvs_size[0],
        (Module.DVS, Dvs.SIZE_ROWS): dvs_size[1],
        (Module.DVS, Dvs.ORIENTATION): 4 if board.dvs_inverted else 0,
        (Module.DVS, Dvs.HAS_PIXEL_FILTER): 1,
        # Background activity, refractory and skip filters are not modelled: the capability bits
        # say so, and hosts then leave them alone.
        (Module.DVS, Dvs.HAS_BA_FILTER): 0,
        (Module.DVS, Dvs.HAS_SKIP): 0,
        (Module.DVS, Dvs.HAS_ROI): 1,
        (Module.DVS, Dvs.HAS_POLARITY): 1,
        (Module.DVS, Dvs.HAS_STATISTICS): 1,
        (Module.APS, Aps.SIZE_COLUMNS): aps_size[0],
        (Module.APS, Aps.SIZE_ROWS): aps_size[1],
        (Module.APS, Aps.ORIENTATION): board.aps_orientation,
        (Module.APS, Aps.COLOR_FILTER): 0,
        (Module.APS, Aps.HAS_GLOBAL_SHUTTER): 1,
        (Module.IMU, Imu.TYPE): 2,
        (Module.IMU, Imu.ORIENTATION): 0,
        (Module.EXTINPUT, 10): 0,
    }


def _power_up(board: Board) -> dict[tuple[int, int], int]:
    values: dict[tuple[int, int], int] = {
        (Module.DVS, Dvs.ROI_END_COLUMN): WIDTH - 1,
        (Module.DVS, Dvs.ROI_END_ROW): HEIGHT - 1,
        (Module.APS, Aps.GLOBAL_SHUTTER): 1,
        (Module.APS, Aps.END_COLUMN): WIDTH - 1,
        (Module.APS, Aps.END_ROW): HEIGHT - 1,
        (Module.APS, Aps.EXPOSURE): board.us_to_adc_cycles(4000),
        (Module.APS, Aps.FRAME_INTERVAL): board.us_to_adc_cycles(40_000),
        (Module.IMU, Imu.ACCEL_FULL_SCALE): 1,
        (Module.IMU, Imu.GYRO_FULL_SCALE): 1,
        (Module.USB, Usb.EARLY_PACKET_DELAY): board.usb_mhz * board.deviation,
    }
    for k in range(8):
        values[Module.DVS, Dvs.FIRST_PIXEL_ROW + 2 * k] = HEIGHT
        values[Module.DVS, Dvs.FIRST_PIXEL_ROW + 2 * k + 1] = WIDTH
    return values


_STATISTICS: dict[tuple[int, int], tuple[tuple[int, int], int]] = {
    (module, param + half): ((module, param), 32 if half == 0 else 0)
    for module, param in (
        (Module.MUX, Mux.DVS_DROPPED),
        (Module.DVS, Dvs.ROW_EVENTS),
        (Module.DVS, Dvs.COLUMN_EVENTS),
        (Module.DVS, Dvs.DROPPED),
        (Module.DVS, Dvs.FILTERED_PIXELS),
    )
    for half in (0, 1)
}


class RegisterFile:
    """All registers of one camera. Not thread safe: the device guards it.

    Args:
        board: The fixed properties of the camera.

    Attributes:
        writes: Number of registers stored so far.
    """

    def __init__(self, board: Board) -> None:
        self._read_only = _read_only(board)
        self._values = _power_up(board)
        self._counters: Counter[tuple[int, int]] = Counter()
        self.writes = 0

    def read(self, module: int, param: int) -> int:
        """Return a register; what was never written and has no default reads 0."""
        key = (module, param)
        if key in _STATISTICS:
            counter, shift = _STATISTICS[key]
            return self._counters[counter] >> shift & _MASK
        if key in self._read_only:
            return self._read_only[key]
        return self._values.get(key, 0)

    def write(self, module: int, param: int, value: int) -> None:
        """Store a register; writes to read-only registers and statistics have no effect."""
        key = (module, param)
        fixed = key in self._read_only or key in _STATISTICS
        if not fixed:
            self._values[key] = value & _MASK
            self.writes += 1

    def count(self, module: int, param: int, amount: int) -> None:
        """Add to the 64-bit statistic whose upper half is at ``param``."""
        self._counters[module, param] += amount
