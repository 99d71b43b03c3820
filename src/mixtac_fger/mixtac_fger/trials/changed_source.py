# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A trial of another source, changed when it is loaded."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    from mixtac_fger.trials.trial_arrays import TrialArrays
    from mixtac_fger.trials.trial_source import TrialSource


@dataclass(frozen=True, slots=True)
class ChangedSource:
    """A changed trial.

    Attributes:
        source: Where the trial comes from.
        label: What to call the change.
        change: Makes the change.
    """

    source: TrialSource
    label: str
    change: Callable[[TrialArrays], TrialArrays]

    @property
    def name(self) -> str:
        """Name of the trial and of the change."""
        return f'{self.source.name}-{self.label}'

    @property
    def origin(self) -> dict[str, Any]:
        """What is known of the trial."""
        return self.source.origin

    def content_key(self) -> str:
        """Return the key of the source with the change."""
        return f'{self.source.content_key()} {self.label}'

    def load(self) -> TrialArrays:
        """Return the changed trial."""
        return self.change(self.source.load())
