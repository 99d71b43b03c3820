# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Modules and parameters of the FPGA logic 18, as addressed by the vendor requests.

Source: facts on libcaer 3.3 and the public FPGA sources. A register is (module, parameter) with an
unsigned 32-bit value; read-only ones are marked RO. Statistics are 64-bit counters (RO): the upper
half at the number given, the lower one at the next.
"""

from __future__ import annotations

from enum import IntEnum

PIXEL_FILTERS = 8
"""Single-pixel filters of the logic, from Dvs.PIXEL_0_ROW on."""


class Module(IntEnum):
    """Module numbers, the first half of a register address."""

    MUX = 0
    DVS = 1
    APS = 2
    IMU = 3
    EXTERNAL_INPUT = 4
    CHIP = 5
    SYSTEM_INFO = 6
    USB = 9


class Mux(IntEnum):
    """Multiplexer: merges the streams and stamps them."""

    RUN = 0
    TIMESTAMP_RUN = 1
    TIMESTAMP_RESET = 2
    RUN_CHIP = 3
    DROP_EXTERNAL_INPUT_ON_STALL = 4
    DROP_DVS_ON_STALL = 5
    STATISTICS_EXTERNAL_INPUT_DROPPED = 81
    STATISTICS_DVS_DROPPED = 83


class Dvs(IntEnum):
    """Event pixels. ROI and pixel filters are in user orientation, end values inclusive."""

    SIZE_COLUMNS = 0
    SIZE_ROWS = 1
    ORIENTATION = 2
    RUN = 3
    WAIT_ON_STALL = 4
    EXTERNAL_AER_CONTROL = 5
    PIXEL_0_ROW = 11
    PIXEL_0_COLUMN = 12
    HAS_BACKGROUND_ACTIVITY_FILTER = 30
    BACKGROUND_ACTIVITY_ENABLE = 31
    BACKGROUND_ACTIVITY_TIME = 32
    REFRACTORY_ENABLE = 33
    REFRACTORY_TIME = 34
    ROI_START_COLUMN = 41
    ROI_START_ROW = 42
    ROI_END_COLUMN = 43
    ROI_END_ROW = 44
    HAS_SKIP = 50
    SKIP_ENABLE = 51
    SKIP_EVERY = 52
    POLARITY_FLATTEN = 61
    POLARITY_SUPPRESS = 62
    POLARITY_SUPPRESS_TYPE = 63
    STATISTICS_ROWS = 81
    STATISTICS_COLUMNS = 83
    STATISTICS_DROPPED = 85
    STATISTICS_FILTERED_PIXELS = 87
    STATISTICS_FILTERED_BACKGROUND_ACTIVITY = 89
    STATISTICS_FILTERED_REFRACTORY = 91


class Aps(IntEnum):
    """Frame pixels. Times are in ADC cycles, the region in user orientation and inclusive."""

    SIZE_COLUMNS = 0
    SIZE_ROWS = 1
    ORIENTATION = 2
    COLOR_FILTER = 3
    RUN = 4
    WAIT_ON_STALL = 5
    GLOBAL_SHUTTER = 7
    START_COLUMN = 8
    START_ROW = 9
    END_COLUMN = 10
    END_ROW = 11
    EXPOSURE = 12
    FRAME_INTERVAL = 13


class Imu(IntEnum):
    """Inertial unit."""

    TYPE = 0
    ORIENTATION = 1
    RUN_ACCELEROMETER = 2
    RUN_GYROSCOPE = 3
    RUN_TEMPERATURE = 4
    SAMPLE_RATE_DIVIDER = 5
    ACCELEROMETER_LOW_PASS = 6
    ACCELEROMETER_SCALE = 7
    GYROSCOPE_LOW_PASS = 9
    GYROSCOPE_SCALE = 10


class ExternalInput(IntEnum):
    """Synchronisation connector: edge detector and pulse generator, times in logic cycles."""

    RUN_DETECTOR = 0
    DETECT_RISING = 1
    DETECT_FALLING = 2
    DETECT_PULSES = 3
    PULSE_POLARITY = 4
    PULSE_LENGTH = 5
    HAS_GENERATOR = 10
    RUN_GENERATOR = 11
    GENERATOR_POLARITY = 12
    GENERATOR_INTERVAL = 13
    GENERATOR_LENGTH = 14
    INJECT_ON_RISING = 15
    INJECT_ON_FALLING = 16


class Chip(IntEnum):
    """Chip configuration bits of module CHIP; 128 to 135 are test pins, those below are biases."""

    RESET_CALIBRATION_NEURON = 136
    TYPE_N_CALIBRATION_NEURON = 137
    RESET_TEST_PIXEL = 138
    AER_NA_ROW = 140
    USE_A_OUT = 141
    GLOBAL_SHUTTER = 142
    SELECT_GRAY_COUNTER = 143
    TEST_ADC = 144


class SystemInfo(IntEnum):
    """What the camera is (all RO). Clocks are nominal MHz, the deviation in 1/1000."""

    LOGIC_VERSION = 0
    CHIP_IDENTIFIER = 1
    DEVICE_IS_MASTER = 2
    LOGIC_CLOCK = 3
    ADC_CLOCK = 4
    USB_CLOCK = 5
    CLOCK_DEVIATION = 6
    LOGIC_PATCH = 7


class Usb(IntEnum):
    """Data endpoint; the early packet delay is in USB clock cycles."""

    RUN = 0
    EARLY_PACKET_DELAY = 1
