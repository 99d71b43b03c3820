# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Estimates of trials on disk."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np

from mixtac_fger.judge.trial_estimate import TrialEstimate

if TYPE_CHECKING:
    from pathlib import Path

_ARRAYS = ('t_us', 'force', 'known', 'reference', 'frames_only')


def save_estimate(path: Path, estimate: TrialEstimate) -> None:
    """Write an estimate as an npz file."""
    arrays = {name: getattr(estimate, name) for name in _ARRAYS}
    words = json.dumps([estimate.name, estimate.profile, estimate.device])
    kept = {name: array for name, array in arrays.items() if array is not None}
    np.savez_compressed(path, words=np.array(words), **kept)


def load_estimate(path: Path) -> TrialEstimate:
    """Read what `save_estimate` wrote."""
    with np.load(path, allow_pickle=False) as kept:
        name, profile, device = json.loads(str(kept['words']))
        arrays: dict[str, Any] = {each: kept.get(each) for each in _ARRAYS}
    return TrialEstimate(name=name, profile=profile, device=device, **arrays)
