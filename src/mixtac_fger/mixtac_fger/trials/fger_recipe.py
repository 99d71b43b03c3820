# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How FGER-Net (the small one) wants its samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mixtac_fger.dataset import (
    CONTACT_N,
    MEASURED_CONTACT_N,
    UNSEEN_BY_SAMPLES,
    make_sample,
    save_sample,
)

if TYPE_CHECKING:
    from pathlib import Path

    from mixtac_fger.config import FgerConfig
    from mixtac_fger.trials.trial_arrays import TrialArrays


@dataclass(frozen=True, slots=True)
class FgerRecipe:
    """Features of frames and windows, in one file per trial.

    Attributes:
        config: Network configuration.
        label: Which force to learn, one of `mixtac_fger.trials.trial_arrays.LABELS`.
    """

    config: FgerConfig
    label: str = 'best'

    @property
    def suffix(self) -> str:
        """Of the files."""
        return '.npz'

    def fingerprint(self) -> dict[str, Any]:
        """Return what changes a sample."""
        fields = self.config.to_dict()
        kept = {name: fields[name] for name in fields if name not in UNSEEN_BY_SAMPLES}
        return {'kind': 'fger 1', 'label': self.label} | kept

    def write(self, trial: TrialArrays, path: Path) -> None:
        """Prepare a trial and write it, whole or not at all.

        Raises:
            DatasetError: As `make_sample`, or the trial has no such force.
        """
        label = trial.label(self.label)
        contact_n = CONTACT_N if label is trial.truth else MEASURED_CONTACT_N
        sample = make_sample(self.config, trial, label, trial.origin, contact_n)
        save_sample(path, sample, self.config)
