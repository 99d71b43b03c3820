# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""One trial as arrays, wherever it came from."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from mixtac_fger.errors import DatasetError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mixtac_events.arrays import Events
    from mixtac_fger.dataset import ForceLabel

LABELS = ('best', 'true', 'reference')
"""Which force: the true one where it is known and the reference otherwise, or one of them."""


@dataclass(frozen=True, slots=True, eq=False)
class TrialArrays:
    """What a camera and a force sensor gave in one trial; camera clock [us].

    Attributes:
        events: Events, sorted.
        frames: Intensities, uint16 [N, height, width].
        exposure_start_us: When each exposure began, int64 [N].
        exposure_end_us: When it ended, int64 [N].
        arrival_us: When the host had the frame, int64 [N].
        truth: True normal force; None where nobody knows it.
        reference: Normal force that the reference sensor measured; None without one.
        origin: Where it came from: seeds, profile, file.
        missing_packets: Event packets that the recorder did not get.
    """

    events: Events
    frames: NDArray[np.uint16]
    exposure_start_us: NDArray[np.int64]
    exposure_end_us: NDArray[np.int64]
    arrival_us: NDArray[np.int64]
    truth: ForceLabel | None
    reference: ForceLabel | None
    origin: dict[str, Any] = field(default_factory=dict)
    missing_packets: int = 0

    @property
    def profile(self) -> str:
        """Force profile, `unknown` for recordings that do not say."""
        return str(self.origin.get('profile', 'unknown'))

    def label(self, kind: str = 'best') -> ForceLabel:
        """Return a force of the trial.

        Args:
            kind: One of `LABELS`.

        Raises:
            DatasetError: It is not known for this trial, or there is no such kind.
        """
        if kind not in LABELS:
            raise DatasetError(f'label {kind!r} is unknown: choose one of {", ".join(LABELS)}')
        chosen = {
            'best': self.truth or self.reference,
            'true': self.truth,
            'reference': self.reference,
        }[kind]
        if chosen is None:
            raise DatasetError(
                f'{self.origin.get("name", "a trial")} has no {kind} force: record the reference'
                ' sensor beside the camera, or choose another label'
            )
        return chosen
