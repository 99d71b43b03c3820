# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Where a model's training data came from and how it was trained."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mixtac_fger import generation

if TYPE_CHECKING:
    from mixtac_fger.train.data import TrainingData
    from mixtac_fger.train.run_config import RunConfig


def provenance(config: RunConfig, data: TrainingData, settings: dict[str, Any]) -> dict[str, Any]:
    """Return what a weight file keeps of its training, JSON-ready.

    Args:
        config: The run.
        data: Its samples.
        settings: Its training settings, complete.
    """
    origins = [source.origin for source in data.sources]
    simulated = all(origin.get('simulated') or 'trial_seed' in origin for origin in origins)
    found: dict[str, Any] = {
        'model': config.model,
        'data': 'simulated (mixtac_sim)' if simulated else 'bags',
        'label': config.data.label,
        'trials': len(data.trained),
        'held_out_trials': len(data.checked),
        'skipped_trials': data.skipped,
        'profiles': sorted({str(origin.get('profile', 'unknown')) for origin in origins}),
        'settings': settings,
    }
    if config.data.simulated is not None:
        found['simulator'] = generation.simulator_digest()
        found['seconds'] = config.data.simulated.seconds
        found['preset'] = config.data.simulated.preset
    if config.data.bags:
        found['bags'] = sorted(str(origin.get('name')) for origin in origins)
    for key, plural in (('device_seed', 'device_seeds'), ('trial_seed', 'trial_seeds')):
        seeds = sorted(int(origin[key]) for origin in origins if key in origin)
        if seeds:
            found[plural] = [seeds[0], seeds[-1]]
    return found
