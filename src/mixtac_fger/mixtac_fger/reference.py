# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The no-contact reference, its file, and the conditions for its renewal.

A contact that is present from the start cannot be seen, because the beads are at random places in
the gel. The first zero therefore requires a release, during which the skin contracts. A later zero
is compared with the reference.
"""

from __future__ import annotations

import threading
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.errors import MixtacError
from mixtac_core.node.files import FileError, replacing, state_file
from mixtac_fger.config import FgerConfig
from mixtac_fger.features import mean_contrast

if TYPE_CHECKING:
    from collections.abc import Collection

    from mixtac_fger.validity import PictureFigures

F32 = NDArray[np.float32]


class TareError(MixtacError):
    """A request for a new zero at a time when it would be wrong."""


_REMEDY = 'delete it, or write a new one with ~/tare while the sensor is untouched'


def reference_name(serial: str) -> str:
    """Return the name of the file that keeps the reference of a camera; empty without a serial."""
    return f'reference_{serial}.npz' if serial.isalnum() else ''


WHITE = 1.1
"""Change over that of white noise of the same roughness, up to which it is noise: at rest 0.95 to
1.05 on three simulated sensors at exposures of 0.2 to 14 ms."""


def is_still(change: F32, stillness: float) -> bool:
    """Return whether a change of the picture is small, or noise alone.

    Noise has no neighbours: a second difference along both axes is six times as large as the change
    itself. Motion of beads, which are several bins wide, is smoother. The limit is the noise of the
    picture itself, however dark it is.

    Args:
        change: Difference of two pictures [log units], float32 [rows, columns].
        stillness: Mean change up to which a picture is still, whatever the change [log units].
    """
    mean = float(np.mean(np.abs(change)))
    if mean <= stillness:
        return True
    along = change[:, :-2] - 2.0 * change[:, 1:-1] + change[:, 2:]
    rough = along[:-2] - 2.0 * along[1:-1] + along[2:]
    return mean < WHITE * float(np.mean(np.abs(rough))) / 6.0


class Reference:
    """The no-contact reference of a sensor; may be used from any thread.

    It is the mean of the first `FgerConfig.reference_frames` frames that do not change.

    Args:
        config: Configuration of the network that prepares the frames.

    Attributes:
        frames: Still frames that make a reference.
        assume_free: Whether the first still frames are assumed to be without contact.
        array: Coarse log contrast without contact, float32 `FgerConfig.frame_shape`; None so far.
        kept: Whether it is stored or tared, and not made of the first frames of this stream.
        number: Number that changes with each new reference, and when one is forgotten.
    """

    def __init__(self, config: FgerConfig) -> None:
        self.frames = config.reference_frames
        self.assume_free = self.kept = False
        self.array: F32 | None = None
        self.number = 0
        self._shape, self._stillness = config.frame_shape, config.reference_stillness
        # What decides how a frame becomes a coarse contrast.
        self._preparation = np.array(
            [config.height, config.width, config.frame_bin, config.gradient_bin, config.log_floor]
        )
        self._lock = threading.Lock()
        self._recent: deque[F32] = deque(maxlen=config.reference_frames)

    @property
    def known(self) -> bool:
        """Whether the reference is known to be without contact: stored, tared or assumed."""
        return self.kept or self.assume_free

    @property
    def progress(self) -> int:
        """Still frames collected, up to `frames`."""
        return len(self._recent)

    def add(self, coarse: F32) -> tuple[F32, int] | None:
        """Add a frame; return the reference and its number, or None while it is incomplete.

        Args:
            coarse: Coarse log contrast of the frame, float32 `FgerConfig.frame_shape`.
        """
        with self._lock:
            if self._recent and not is_still(coarse - mean_contrast(self._recent), self._stillness):
                self._recent.clear()
            self._recent.append(coarse)
            if self.array is None and len(self._recent) == self.frames:
                self._set(mean_contrast(self._recent))
            return None if self.array is None else (self.array, self.number)

    def renew(self) -> None:
        """Make the latest frames the reference.

        Raises:
            TareError: There are too few frames since the last motion.
        """
        with self._lock:
            if len(self._recent) < self.frames:
                raise TareError(
                    f'only {len(self._recent)} of {self.frames} still frames since the last motion',
                    remedy='leave the sensor untouched and try again',
                )
            self._set(mean_contrast(self._recent))
            self.kept = True

    def use(self, array: F32) -> None:
        """Use a stored reference from now on.

        Args:
            array: Coarse log contrast without contact, float32 `FgerConfig.frame_shape`.
        """
        with self._lock:
            self._set(array)
            self.kept = True

    def forget(self) -> None:
        """Start over: the next still frames become the reference."""
        with self._lock:
            self.array, self.kept = None, False
            self._recent.clear()
            # Results of frames that were compared with it are discarded, as after a replacement.
            self.number += 1

    def save(self, path: Path) -> None:
        """Write the reference to a `.npz` file; an existing file is replaced.

        Raises:
            FileError: There is no reference yet, or the file cannot be written.
        """
        if self.array is None:
            raise FileError('there is no reference yet', remedy='show still frames first')
        with replacing(path) as scratch, scratch.open('wb') as file:
            np.savez(file, contrast=self.array, preparation=self._preparation)

    def load(self, path: Path) -> F32:
        """Read a file that `save` wrote, use its reference and return it.

        Raises:
            FileError: The file is missing or damaged, or its reference was prepared in
                another way.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                contrast, preparation = np.asarray(file['contrast']), file['preparation']
        except Exception as error:  # parsers raise whatever damage leads them to
            raise FileError(f'{path} is not a reference file ({error})', remedy=_REMEDY) from error
        fits = np.array_equal(preparation, self._preparation) and contrast.shape == self._shape
        if not fits or not np.isfinite(contrast).all():
            raise FileError(
                f'reference {path} is not an image as this model prepares it', remedy=_REMEDY
            )
        array = np.ascontiguousarray(contrast, np.float32)
        self.use(array)
        return array

    def _set(self, array: F32) -> None:
        self.array = array
        self.number += 1


def stored_reference(name: str, reference: Reference | None) -> F32 | None:
    """Use the stored reference of a sensor, and return it; None without one.

    Args:
        name: Name of the file in the state folder; empty for none.
        reference: Reference of an estimator; None if the estimator needs none.

    Raises:
        MixtacError: The name is not plain, or the file cannot be used.
    """
    if not name:
        return None
    path = state_file(name)
    if reference is None or not path.exists():
        return None
    return reference.load(path)


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
        reference: Reference with which frames are compared.

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
        """Whether the skin has contracted since the start, or was stretched and came back."""
        if abs(self._outward) > CONTACT:
            return self._outward < 0.0
        return self._most > 2.0 * CONTACT

    @property
    def due(self) -> bool:
        """Whether a contact has ended and a long enough rest has followed."""
        return self._touched and self._rest >= REST_FRAMES

    def frame(self, picture: PictureFigures, force: float, *, light: bool) -> None:
        """Add a frame.

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
            picture: Comparison of the latest frame; None if it was not compared.
            forces: Latest estimates [N].
            contact_n: Absolute force from which on there is contact [N].

        Raises:
            TareError: The sensor is in contact, saw no release, or has too few still frames.
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
                'something may have touched the sensor at the start, and no release was seen since',
                remedy='touch the sensor, release it and try again, or set assume_free',
            )
        self._reference.renew()
        self.restart()
