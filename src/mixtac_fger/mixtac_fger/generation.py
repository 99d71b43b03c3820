# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Simulating training trials on all cores, kept on disk until the simulator changes."""

from __future__ import annotations

import hashlib
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

from mixtac_fger.dataset import load_sample, make_sample, save_sample, true_force
from mixtac_fger.errors import DatasetError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mixtac_fger.config import FgerConfig
    from mixtac_fger.dataset import Sample
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


def simulator_digest() -> str:
    """Return a short digest of the simulator's source: samples of another simulator are stale."""
    import mixtac_sim

    digest = hashlib.sha256()
    for path in sorted(Path(str(mixtac_sim.__file__)).parent.rglob('*.py')):
        if 'usb' not in path.parts:
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def generate(
    specs: Sequence[TrialSpec], config: FgerConfig, folder: Path, jobs: int
) -> Iterator[Sample]:
    """Yield the samples of all trials in order; those on disk are read, the rest simulated.

    Args:
        specs: Trials.
        config: Network configuration.
        folder: Where samples are kept.
        jobs: Processes that simulate.
    """
    target = folder / simulator_digest()
    if jobs <= 1:
        for spec in specs:
            yield _sample(spec, config, target)
        return
    context = multiprocessing.get_context('spawn')
    with ProcessPoolExecutor(jobs, mp_context=context) as pool:
        paths = pool.map(_make, specs, [config] * len(specs), [target] * len(specs))
        yield from (load_sample(path, config) for path in paths)


def _sample(spec: TrialSpec, config: FgerConfig, folder: Path) -> Sample:
    return load_sample(_make(spec, config, folder), config)


def _make(spec: TrialSpec, config: FgerConfig, folder: Path) -> Path:
    """Make sure that the sample of a trial is on disk."""
    path = folder / f'{spec.name}.npz'
    try:
        load_sample(path, config)
    except DatasetError:
        trial = simulate(spec)
        save_sample(
            path, make_sample(config, trial, true_force(trial.truth), spec.to_dict()), config
        )
    return path
