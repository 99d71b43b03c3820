# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""One trial of a data set: everything that its simulation depends on."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Final

from mixtac_events.errors import MixtacError

SPLITS: Final = ('train', 'test')
DEFAULT_PRESET: Final = 'paper_like'


class DatasetError(MixtacError):
    """A description of a data set or of a trial that cannot be read or is not allowed."""


@dataclass(frozen=True, slots=True)
class TrialSpec:
    """One simulated trial.

    Attributes:
        name: Name of its bag.
        profile: Force profile, as in `mixtac_sim.profiles.make_profile`.
        seconds: Length [s].
        device_seed: Which sensor: beads, gel, mesh, lens, lamp, pixels.
        trial_seed: Which day: contact point, forces, noise, clocks.
        preset: How hard the effects are.
        split: `train` or `test`.
    """

    name: str
    profile: str
    seconds: float
    device_seed: int
    trial_seed: int
    preset: str
    split: str

    def __post_init__(self) -> None:
        """Refuse what cannot be a bag's name or a split.

        Raises:
            DatasetError: As above.
        """
        if not self.name.replace('_', '').replace('-', '').isalnum():
            raise DatasetError(
                f'trial name {self.name!r} would not be a folder: use letters, digits, _ and -'
            )
        if self.split not in SPLITS:
            raise DatasetError(f'split {self.split!r} is unknown: use one of {SPLITS}')

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as values for YAML or JSON."""
        return asdict(self)

    @staticmethod
    def from_dict(fields: dict[str, Any]) -> TrialSpec:
        """Return the trial of such values.

        Raises:
            DatasetError: A field is missing, unknown or not allowed.
        """
        try:
            spec = TrialSpec(**fields)
        except TypeError as error:
            raise DatasetError(f'a trial cannot be read from {fields}: {error}') from error
        return spec
