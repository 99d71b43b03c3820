# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Simulating a trial, and telling one simulator from another."""

from __future__ import annotations

import functools
import hashlib
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
