# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Normal force of a Mixtac sensor in Python, without ROS.

from mixtac import Sensor

with Sensor('virtual') as s:
    print(s.read())
"""

from mixtac.latest import (
    NoReadingError,
    NotOpenError,
    ReadTimeoutError,
    SensorError,
    StaleReadingError,
)
from mixtac.sensor import Picture, Reading, Sensor
from mixtac_driver.errors import NoCameraError
from mixtac_events.errors import MixtacError
from mixtac_fger.config import ModelError
from mixtac_fger.reference import TareError

__all__ = [
    'MixtacError',
    'ModelError',
    'NoCameraError',
    'NoReadingError',
    'NotOpenError',
    'Picture',
    'ReadTimeoutError',
    'Reading',
    'Sensor',
    'SensorError',
    'StaleReadingError',
    'TareError',
]
