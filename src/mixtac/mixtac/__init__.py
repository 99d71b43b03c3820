# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Normal force of a Mixtac sensor in Python, without ROS.

from mixtac import Sensor

with Sensor('virtual') as s:
    print(s.read())
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mixtac.latest import (
        NoReadingError,
        NotOpenError,
        ReadTimeoutError,
        SensorError,
        StaleReadingError,
    )
    from mixtac.sensor import Picture, Reading, Sensor
    from mixtac_core.events.errors import MixtacError
    from mixtac_driver.errors import NoCameraError
    from mixtac_fger.config import ModelError
    from mixtac_fger.reference import TareError

HOMES = {
    'MixtacError': 'mixtac_core.events.errors',
    'ModelError': 'mixtac_fger.config',
    'NoCameraError': 'mixtac_driver.errors',
    'Picture': 'mixtac.sensor',
    'Reading': 'mixtac.sensor',
    'Sensor': 'mixtac.sensor',
    'TareError': 'mixtac_fger.reference',
}
"""Modules of the names that are not in `mixtac.latest`."""

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


def __getattr__(name: str) -> object:
    """Import a name of the interface when it is first used: the command starts without it."""
    if name not in __all__:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(import_module(HOMES.get(name, 'mixtac.latest')), name)
