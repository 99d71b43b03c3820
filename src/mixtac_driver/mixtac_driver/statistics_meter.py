# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The camera's own counters as rates and totals, for `/diagnostics`."""

from __future__ import annotations

import time
from dataclasses import asdict
from typing import TYPE_CHECKING

from mixtac_driver.errors import DriverError
from mixtac_node.rates import RateMeter

if TYPE_CHECKING:
    from mixtac_driver.camera_control import CameraControl
    from mixtac_driver.statistics import CameraStatistics

DROPPED = ('dropped', 'external_input_dropped', 'dvs_dropped')
"""Shown as totals; the others as rates."""


class StatisticsMeter:
    """Reads the counters of a camera whenever asked.

    Args:
        control: Of the camera.

    Attributes:
        fresh_losses: What the camera dropped, though nobody asked for it, since the read before.
    """

    def __init__(self, control: CameraControl) -> None:
        self.fresh_losses = 0
        self._control = control
        self._lost = 0
        self._rates: dict[str, RateMeter] = {}

    def read(self) -> dict[str, object]:
        """Return figures by name; none while there is no camera to ask."""
        self.fresh_losses = 0
        try:
            statistics = self._control.statistics()
        except DriverError:
            # What reads the data says what is wrong with the camera.
            return {}
        return {} if statistics is None else self._figures(statistics)

    def _figures(self, statistics: CameraStatistics) -> dict[str, object]:
        # A camera that was opened anew counts from zero.
        self.fresh_losses = max(statistics.lost - self._lost, 0)
        self._lost = statistics.lost
        figures: dict[str, object] = {}
        now_s = time.monotonic()
        for name, total in asdict(statistics).items():
            words = f'camera {name.replace("_", " ")}'
            if name in DROPPED:
                figures[words] = total
            else:
                meter = self._rates.setdefault(name, RateMeter())
                meter.total = total
                figures[f'{words} per second'] = max(meter.read(now_s), 0.0)
        return figures
