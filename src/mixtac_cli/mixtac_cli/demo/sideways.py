# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The demo's second part: a pull sideways and a roll, against the simulated force and place.

It has a bag of its own, so that no figure of the first part depends on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mixtac_cli.demo.evaluation import host_time, read_streams
from mixtac_node import topics
from mixtac_recordings.bag import BagFile
from mixtac_sim.grids import STEP_US
from mixtac_sim.world.device import draw_conditions
from mixtac_sim.world.effects import preset
from mixtac_sim.world.profiles import make_profile
from mixtac_sim.world.segments import still

SCENARIO: Final = 'pull_and_roll'
SECONDS: Final = 4.0
"""Length of the second part [s]."""
TOUCHED_N: Final = 0.03
"""Simulated normal force from which on a window counts [N]."""


@dataclass(frozen=True, slots=True, eq=False)
class SidewaysRun:
    """The second part, in the contact frame; n windows whose sideways force is known.

    Attributes:
        time_s: Ends of the windows since the first, float64 [n].
        force_n: Estimated sideways force, right and up in the image [n, 2] [N].
        truth_n: Simulated force, x, y and normal [n, 3] [N].
        unknown: Windows in contact without a sideways force.
        place_mm: Estimated places of the contact [m, 2].
        path_mm: Simulated path of the indenter [k, 2].
    """

    time_s: NDArray[np.float64]
    force_n: NDArray[np.float64]
    truth_n: NDArray[np.float64]
    unknown: int
    place_mm: NDArray[np.float64]
    path_mm: NDArray[np.float64]

    @property
    def figures(self) -> dict[str, float | int | None]:
        """`sideways_mae_n`, `sideways_size_n`, `sideways_peak_n` and `sideways_unknown`."""
        touched = self.truth_n[:, 2] > TOUCHED_N
        truth, found = self.truth_n[touched, :2], self.force_n[touched]
        known = len(truth) > 0
        return {
            'sideways_mae_n': float(np.abs(found - truth).mean()) if known else None,
            'sideways_size_n': float(np.abs(truth).mean()) if known else None,
            'sideways_peak_n': float(np.hypot(*truth.T).max()) if known else None,
            'sideways_unknown': self.unknown,
        }


def true_path(seed: int, level: str) -> NDArray[np.float64]:
    """Return the path of the indenter while it presses, right and up [mm] [k, 2].

    Args:
        seed: Seed of the sensor's conditions; its second scenario has the next one.
        level: Preset of the sensor.
    """
    difficulty = preset(level)
    profile = make_profile(SCENARIO, seed + 1, SECONDS, preset=difficulty)
    count = round(1e6 * SECONDS / STEP_US)
    steps, (modes, _, _) = profile.motion(0, count), profile.commands(0, count)
    if steps is None:
        steps = still(count)
    start = np.array(draw_conditions(seed, difficulty).contact_mm)
    path = start + np.cumsum(steps[:, :2] + steps[:, 3:5], axis=0)
    return np.asarray(path[modes > 0] * (1.0, -1.0), np.float64)


def read_sideways(bag: Path, namespace: str, path_mm: NDArray[np.float64]) -> SidewaysRun:
    """Read the second part.

    Args:
        bag: Its bag.
        namespace: Of the sensor.
        path_mm: From `true_path`.

    Raises:
        RecordingError: A topic is missing or the bag is damaged.
    """
    streams = read_streams(bag, namespace)
    with BagFile(bag) as opened:
        places = [
            (1e3 * message.position.x, 1e3 * message.position.y)
            for _, _, message in opened.messages(topics.CONTACT.resolved(namespace))
            if message.located
        ]
    # The clock of the camera stood still while the scenario was computed.
    host_ns = host_time(streams, streams.force_ns, None)
    inside = (host_ns >= streams.truth_ns[0]) & (host_ns <= streams.truth_ns[-1])
    true = [np.interp(host_ns, streams.truth_ns, column) for column in streams.truth_n.T]
    at = np.stack(true, axis=1)
    known = np.isin(streams.force_ns, streams.sideways_ns)
    kept = inside & known
    return SidewaysRun(
        time_s=1e-9 * (streams.force_ns[kept] - streams.force_ns[:1]),
        force_n=streams.force_n[kept, :2],
        truth_n=at[kept],
        unknown=int((inside & ~known & (at[:, 2] > TOUCHED_N)).sum()),
        place_mm=np.array(places, np.float64).reshape(-1, 2),
        path_mm=path_mm,
    )
