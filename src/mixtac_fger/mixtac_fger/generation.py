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
    """Return a short digest of the simulator's source: samples of another simulator are stale."""
    import mixtac_sim

    digest = hashlib.sha256()
    for path in sorted(Path(str(mixtac_sim.__file__)).parent.rglob('*.py')):
        if 'usb' not in path.parts:
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]
