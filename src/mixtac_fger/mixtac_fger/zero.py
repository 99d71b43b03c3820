# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whether the zero of a sensor is known, how it drifts, and when it may be renewed.

A contact that was there from the start looks like none, since beads lie anywhere in a gel. So a
first zero needs a release, which draws the skin together; a later one is compared with the
reference.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixtac_fger.reference import TareError

if TYPE_CHECKING:
    from collections.abc import Collection

    from mixtac_fger.reference import Reference
    from mixtac_fger.validity import PictureFigures

CONTACT = 0.006
"""Outward displacement that a contact makes [bins]: without one up to 0.005, of 0.1 N 0.009 to
0.06; a release of 0.2 N draws the skin together by 0.015 and more."""
SETTLE_FRAMES = 12
"""Frames after a contact in which the gel recovers and the force is not yet the zero."""
REST_FRAMES = 50
"""Frames at rest after which the zero may be renewed: 2 s at 25 Hz."""
DRIFT_SHARE = 0.05
"""Least share by which the drift follows a frame."""


class Zero:
    """Follows the frames of a sensor since the start, or since the latest tare.

    Args:
        reference: What its frames are compared with.

    Attributes:
        drift: Mean force that frames show while nothing touches the sensor, before any calibration
            [N]; of the latest rest while something touches.
    """

    def __init__(self, reference: Reference) -> None:
        self._reference = reference
        self.restart()

    def restart(self) -> None:
        """Forget all frames."""
        self.drift = self._most = self._outward = 0.0
        self._touched = False
        self._rest = 0

    @property
    def released(self) -> bool:
        """Whether the skin drew together since the start, or was pushed apart and came back."""
        if abs(self._outward) > CONTACT:
            return self._outward < 0.0
        return self._most > 2.0 * CONTACT

    @property
    def due(self) -> bool:
        """Whether a contact has ended and a long enough rest has followed."""
        return self._touched and self._rest >= REST_FRAMES

    def frame(self, picture: PictureFigures, force: float, *, light: bool) -> None:
        """Take a frame.

        Args:
            picture: Comparison with the reference.
            force: Its force [N].
            light: Whether the force is too small for a contact.
        """
        self._outward = picture.outward
        self._most = max(self._most, picture.outward)
        free = abs(picture.outward) < CONTACT if self._reference.known else self.released
        still = self._reference.progress == self._reference.frames
        self._touched |= not free
        self._rest = self._rest + 1 if free and still and light else 0
        if self._rest > SETTLE_FRAMES:
            share = max(1.0 / (self._rest - SETTLE_FRAMES), DRIFT_SHARE)
            self.drift += (force - self.drift) * share

    def renew(
        self, picture: PictureFigures | None, forces: Collection[float], contact_n: float
    ) -> None:
        """Make the latest frames the reference, and start over.

        Args:
            picture: Of the latest frame; None if it was not compared.
            forces: Latest estimates [N].
            contact_n: Size of a force from which on it is a contact [N].

        Raises:
            TareError: In contact, no release was seen, or too few still frames.
        """
        largest, known = max(forces, key=abs), self._reference.known
        if known and abs(largest) > contact_n:
            raise TareError(
                f'in contact ({largest:.2f} N within the last {len(forces)} windows)',
                remedy='release the sensor and try again',
            )
        outward = 0.0 if picture is None or picture.unexplained() > 1.0 else picture.outward
        if known and abs(outward) > CONTACT:
            raise TareError(
                'in contact: the skin is displaced against the reference',
                remedy='release the sensor and try again; delete the stored reference if it is that'
                ' of a contact',
            )
        if not known and picture is not None and not self.released:
            raise TareError(
                'nobody knows whether something touched the sensor at the start, and no release'
                ' was seen since',
                remedy='touch the sensor, release it and try again, or set assume_free',
            )
        self._reference.renew()
        self.restart()
