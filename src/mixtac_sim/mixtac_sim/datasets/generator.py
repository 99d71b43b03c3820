# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which simulator made a data set."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

from mixtac_sim.datasets.description import DatasetDescription

if TYPE_CHECKING:
    from mixtac_sim.datasets.trial_spec import TrialSpec

PACKAGE = 'mixtac_sim'


def generator_version() -> str:
    """Return the version of the package, `unknown` where it is not installed."""
    try:
        return metadata.version(PACKAGE)
    except metadata.PackageNotFoundError:
        return 'unknown'


@cache
def generator_digest() -> str:
    """Return a short digest of the simulator's source: another digest means other trials."""
    digest = hashlib.sha256()
    root = Path(__file__).parent.parent
    for path in sorted(root.rglob('*.py')):
        if 'usb' not in path.relative_to(root).parts:
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def describe(
    name: str, seed: int, preset: str, split_by: str, trials: list[TrialSpec]
) -> DatasetDescription:
    """Return the description of trials that this simulator is about to make."""
    generator = {
        'package': PACKAGE,
        'version': generator_version(),
        'digest': generator_digest(),
    }
    return DatasetDescription(name, seed, preset, split_by, tuple(trials), generator)
