# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Where a trial comes from, before it is loaded."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from mixtac_fger.trials.trial_arrays import TrialArrays


class TrialSource(Protocol):
    """A trial that can be loaded when it is needed."""

    @property
    def name(self) -> str:
        """What to call it in messages; part of file names."""

    @property
    def origin(self) -> dict[str, Any]:
        """What is known before loading: device, profile, path."""

    def content_key(self) -> str:
        """Return a text that changes when the content of the trial does.

        Raises:
            MixtacError: It cannot be read.
        """

    def load(self) -> TrialArrays:
        """Return the trial.

        Raises:
            MixtacError: It cannot be used; the text says why.
        """
