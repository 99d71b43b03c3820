# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Simulating a trial, and telling one simulator from another."""

from __future__ import annotations

import functools
import hashlib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mixtac_fger.trial_plan import TrialSpec
    from mixtac_sim.trial import Trial

_APART = {'usb', 'arm', 'grasp', 'datasets'}
"""Parts of the simulator that no trial is made with."""
_NODES = ('_node', '_parameters', '_cli')
"""Ends of the names of modules that only run it."""


def simulate(spec: TrialSpec) -> Trial:
    """Return the trial that `spec` names, with synchronising impulses and the rest around them."""
    from mixtac_sim.presets import preset
    from mixtac_sim.trial import simulate_trial

    chosen = preset(spec.preset)
    if spec.without:
        chosen = chosen.without(spec.without)
    seeds = (spec.device_seed, spec.trial_seed)
    return simulate_trial(*seeds, spec.profile, spec.seconds, sync=True, preset=chosen)


def stiffness(spec: TrialSpec, *, known_sensor: bool = False) -> float:
    """Return how stiff the gel of a trial is over what a model can know before it.

    Args:
        spec: The trial.
        known_sensor: The sensor's usual stiffness is known, and only that of the day is not.

    Returns:
        Modulus of sensor and day over the usual modulus of all sensors, or of this one.
    """
    from mixtac_sim.conditions import draw_conditions
    from mixtac_sim.device import draw_device
    from mixtac_sim.presets import preset

    chosen = preset(spec.preset)
    day = draw_conditions(spec.trial_seed, chosen).stiffness
    if known_sensor:
        return day
    alike = replace(chosen, gel=replace(chosen.gel, modulus_log_sd=0.0))
    usual, own = (draw_device(spec.device_seed, each) for each in (alike, chosen))
    return day * own.layer.modulus_kpa / usual.layer.modulus_kpa


@functools.cache
def simulator_digest() -> str:
    """Return a short digest of the source that makes trials: samples of another one are stale."""
    import mixtac_sim

    root = Path(str(mixtac_sim.__file__)).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob('*.py')):
        apart = _APART.intersection(path.relative_to(root).parts)
        if not apart and not path.stem.endswith(_NODES):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]
