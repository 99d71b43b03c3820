# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Where the time of a simulation goes, from Python's own profiler."""

from __future__ import annotations

import cProfile
import pstats
from pathlib import PurePath
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

STAGES: Final = {
    'mechanics': {('touch.py', 'block'), ('bead_motion.py', 'place')},
    'rendering': {('renderer.py', 'draw')},
    'event pixels': {('dvs.py', 'step')},
    'event noise': {('noise.py', 'block')},
    'event readout': {('readout.py', 'read')},
    'frames': {('aps.py', 'expose_before'), ('aps.py', 'expose_after'), ('aps.py', 'finish')},
    'reference sensor': {('reference.py', 'process')},
    'inertial unit': {('inertial_unit.py', 'readings')},
    'USB words': {('device.py', 'submit'), ('device.py', 'advance')},
    'USB reads': {('host_side.py', 'read_bulk')},
    'camera messages': {('camera_messages.py', 'add')},
    'truth messages': {('truth_messages.py', 'add')},
    'bag': {('writer.py', 'write'), ('writer.py', 'close'), ('writer.py', 'add_connection')},
}
"""Functions of each stage as (file, name); none of them calls one of another stage."""


def time_by_stage(call: Callable[[], object]) -> dict[str, float]:
    """Run something and return the share of its time that each stage took; they add up to 1.

    Args:
        call: What to run; the profiler makes it somewhat slower.
    """
    profiler = cProfile.Profile()
    profiler.runcall(call)
    return stage_shares(pstats.Stats(profiler))


def stage_shares(stats: pstats.Stats) -> dict[str, float]:
    """Return the share of each stage in the profiled time, largest first, the rest as `other`."""
    table = stats.stats  # type: ignore[attr-defined]
    total = float(stats.total_tt)  # type: ignore[attr-defined]
    spent = dict.fromkeys(STAGES, 0.0)
    for (path, _, name), (_, _, _, cumulative, _) in table.items():
        key = (PurePath(path).name, name)
        for stage, functions in STAGES.items():
            if key in functions:
                spent[stage] += cumulative
    shares = {stage: seconds / total for stage, seconds in spent.items() if seconds > 0.0}
    shares['other'] = max(1.0 - sum(shares.values()), 0.0)
    return dict(sorted(shares.items(), key=lambda item: -item[1]))
