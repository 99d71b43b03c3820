# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Windows and a planner for tests."""

from __future__ import annotations

from typing import Any

import numpy as np

from mixtac_slip_control.detectors import LEARNING_WINDOWS
from mixtac_slip_control.features import SlipWindow


def window(
    index: int,
    count: int = 30,
    flow: tuple[float, float] = (0.0, 0.0),
    *,
    guided: bool = True,
    complete: bool = True,
    light: bool = False,
    noise: float = 1e-5,
) -> SlipWindow:
    return SlipWindow(1000 * (index + 1), count, *flow, 0.0, guided, complete, light, noise)


def quiet_windows(number: int = LEARNING_WINDOWS, seed: int = 0) -> list[SlipWindow]:
    rng = np.random.default_rng(seed)
    counts = rng.poisson(30.0, number)
    flows = rng.normal(0.0, 0.002, (number, 2))
    return [
        window(i, int(n), (float(f[0]), float(f[1])))
        for i, (n, f) in enumerate(zip(counts, flows, strict=True))
    ]


class FakePlanner:
    """Moves at once and records its calls."""

    def __init__(self) -> None:
        self.targets: list[float] = []
        self.resets: list[Any] = []
        self.stopped = 0
        self.velocity = 0.0
        self.error: Exception | None = None
        self.moves = False
        self.max_advance = 0.0
        self.line = None

    def reset(self, q: Any, normal: Any, max_advance: float) -> None:
        self.resets.append((tuple(q), tuple(normal)))
        self.max_advance = max_advance

    def moving(self, now_s: float) -> bool:
        return self.moves

    def plan(self, now_s: float, advance_m: float) -> Any:
        if self.error is not None:
            raise self.error
        self.targets.append(advance_m)
        return (now_s, advance_m)

    def stop(self, now_s: float) -> Any:
        if self.error is not None:
            raise self.error
        self.stopped += 1
        return (now_s, 'stop')

    def advance_at(self, t_s: float) -> float:
        return self.velocity * t_s
