# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Camera frames: encoding against the no-contact reference, its thread, the reference file."""

from __future__ import annotations

import contextlib
import os
import queue
import threading
import zipfile
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_events.errors import MixtacError
from mixtac_fger.features import EventGuide, FramePreparation, ImageError, mean_contrast
from mixtac_fger.frame_network import frame_maps, frame_step, frame_weights, row_scratch

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from mixtac_fger.config import FgerConfig
    from mixtac_learning.network import FgerNetwork

    F32 = NDArray[np.float32]
    Image = NDArray[np.uint8] | NDArray[np.uint16]


class TareError(MixtacError):
    """A request for a new zero that would be wrong now."""


class ReferenceFileError(MixtacError):
    """A stored no-contact reference that cannot be read, written or used."""


@dataclass(frozen=True, slots=True, eq=False)
class EncodedFrame:
    """A frame as the recurrent path uses it.

    Attributes:
        mid_us: Centre of the exposure, camera clock [us].
        feature: f_frame, float32 [frame_size].
        guide: What events are multiplied with from now on.
        force: Frames-only force [N].
        reference: `FrameEncoder.reference_number` of the reference it was compared with.
    """

    mid_us: int
    feature: F32
    guide: EventGuide
    force: float
    reference: int


class FrameEncoder:
    """Runs the frame network and keeps the no-contact reference; may be called from any thread.

    The reference is the mean of the first `FgerConfig.reference_frames` frames that do not change.
    Until it is complete there is nothing to compare with and frames give nothing.

    Args:
        network: Weights are copied out of it.
    """

    def __init__(self, network: FgerNetwork) -> None:
        self._config = network.config
        self._weights = frame_weights(network.frame, network.config)
        self._maps = frame_maps(network.config)
        self._scratch = row_scratch(network.config)
        self._preparation = FramePreparation(network.config)
        self._lock = threading.Lock()
        self._recent: deque[F32] = deque(maxlen=network.config.reference_frames)
        self._reference: F32 | None = None
        self._number = 0
        self._disturbances = 0

    @property
    def reference_complete(self) -> bool:
        """Whether there is a reference."""
        return self._reference is not None

    @property
    def reference(self) -> F32 | None:
        """Coarse log contrast without contact, float32 `FgerConfig.frame_shape`; None so far."""
        return self._reference

    @property
    def reference_number(self) -> int:
        """How often there was a new reference."""
        return self._number

    @property
    def reference_progress(self) -> int:
        """Still frames at hand for the reference, up to `FgerConfig.reference_frames`."""
        return len(self._recent)

    @property
    def disturbances(self) -> int:
        """How often motion restarted the reference."""
        return self._disturbances

    def encode(
        self, image: NDArray[np.uint16] | NDArray[np.uint8], mid_us: int
    ) -> EncodedFrame | None:
        """Encode a frame; None while the reference is being collected.

        Args:
            image: Intensity, [height, width], any number of bits.
            mid_us: Centre of the exposure, camera clock [us].

        Raises:
            ImageError: The image has another size.
        """
        with self._lock:
            contrast = self._preparation.contrast(image)
            self._remember(contrast.coarse)
            if self._reference is None:
                return None
            inputs = self._preparation.network_input(contrast, self._reference)
            feature = np.empty(self._config.frame_size, np.float32)
            force = frame_step(inputs, self._weights, self._maps, self._scratch, feature)
            guide = self._preparation.guide(contrast)
            return EncodedFrame(mid_us, feature, guide, float(force), self._number)

    def renew_reference(self) -> None:
        """Make the latest frames the reference.

        Raises:
            TareError: There are too few frames since the last motion.
        """
        with self._lock:
            if not self._full():
                wanted = self._config.reference_frames
                raise TareError(
                    f'{len(self._recent)} of {wanted} still frames at hand: keep the sensor'
                    ' untouched and try again'
                )
            self._use(mean_contrast(self._recent))

    def use_reference(self, reference: F32) -> None:
        """Compare with this from now on.

        Args:
            reference: Coarse log contrast without contact, float32 `FgerConfig.frame_shape`.
        """
        with self._lock:
            self._use(reference)

    def forget_reference(self) -> None:
        """Start over: the next still frames become the reference."""
        with self._lock:
            self._reference = None
            self._recent.clear()

    def _use(self, reference: F32) -> None:
        self._reference = reference
        self._number += 1

    def _full(self) -> bool:
        return len(self._recent) == self._config.reference_frames

    def _remember(self, coarse: F32) -> None:
        if self._recent:
            change = np.mean(np.abs(coarse - mean_contrast(self._recent)))
            if change > self._config.reference_stillness:
                self._recent.clear()
                self._disturbances += self._reference is None
        self._recent.append(coarse)
        if self._reference is None and self._full():
            self._use(mean_contrast(self._recent))


WAITING_RESULTS = 4
"""Encoded frames that wait to be fetched; of more the oldest are dropped."""
NICENESS = 5
"""Of the thread: where processors are scarce, 500 Hz windows come before 25 Hz frames."""


class FrameWorker:
    """Encodes the latest frame in the background; at most one waits, newer ones replace it.

    Attributes:
        refused: Frames of a size that the model does not read.
        problem: Why the latest of these was refused.

    Args:
        encoder: Shared with the owner for its reference.
    """

    def __init__(self, encoder: FrameEncoder) -> None:
        self._encoder = encoder
        self._inbox: queue.Queue[tuple[Image, int] | None] = queue.Queue()
        self._outbox: deque[EncodedFrame] = deque()
        self._thread = threading.Thread(target=self._run, name='fger_frames', daemon=True)
        self._replaced = self._unfetched = 0
        self.refused = 0
        self.problem = ''
        self._closed = False
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the thread runs, or has been ended on purpose."""
        return self._closed or self._thread.is_alive()

    @property
    def dropped(self) -> int:
        """Frames replaced by a newer one before they were encoded or fetched."""
        return self._replaced + self._unfetched

    def push(self, image: Image, mid_us: int) -> None:
        """Hand over a frame; the caller must not change `image` afterwards."""
        try:
            while self._inbox.get_nowait() is not None:
                self._replaced += 1
        except queue.Empty:
            pass
        self._inbox.put((image, mid_us))

    def results(self) -> list[EncodedFrame]:
        """Return the frames encoded since the last call, oldest first."""
        found = []
        while True:
            try:
                found.append(self._outbox.popleft())
            except IndexError:
                return found

    def close(self) -> None:
        """End the thread."""
        self._closed = True
        self._inbox.put(None)
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)
        while (job := self._inbox.get()) is not None:
            try:
                encoded = self._encoder.encode(*job)
            except ImageError as error:
                self.refused += 1
                self.problem = str(error)
                continue
            if encoded is not None:
                self._hand_out(encoded)

    def _hand_out(self, frame: EncodedFrame) -> None:
        with contextlib.suppress(IndexError):
            while len(self._outbox) >= WAITING_RESULTS:
                self._outbox.popleft()
                self._unfetched += 1
        self._outbox.append(frame)


_REMEDY = 'delete it, or write a new one with ~/tare while the sensor is untouched'


def save_reference(path: Path, contrast: F32, config: FgerConfig) -> None:
    """Write a reference; an existing file is replaced only once the new one is complete.

    Args:
        path: File, `.npz` by custom.
        contrast: Coarse log contrast without contact, float32 `FgerConfig.frame_shape`.
        config: Of the network that prepared it.

    Raises:
        ReferenceFileError: The file cannot be written.
    """
    partial = path.with_name(path.name + '.partial')
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with partial.open('wb') as file:
            np.savez(file, contrast=contrast, preparation=_preparation(config))
        partial.replace(path)
    except OSError as error:
        raise ReferenceFileError(f'reference {path} cannot be written: {error}') from error


def load_reference(path: Path, config: FgerConfig) -> F32:
    """Return a reference that `save_reference` wrote.

    Args:
        path: File.
        config: Of the network that reads it.

    Raises:
        ReferenceFileError: The file is missing or damaged, or was prepared in another way.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            contrast, preparation = np.asarray(file['contrast']), np.asarray(file['preparation'])
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise ReferenceFileError(f'reference {path} cannot be read ({error}): {_REMEDY}') from error
    if not np.array_equal(preparation, _preparation(config)):
        raise ReferenceFileError(
            f'reference {path} was made for a model that prepares frames in another way: {_REMEDY}'
        )
    if contrast.shape != config.frame_shape or not np.isfinite(contrast).all():
        raise ReferenceFileError(f'reference {path} holds no picture of this model: {_REMEDY}')
    return np.ascontiguousarray(contrast, np.float32)


def _preparation(config: FgerConfig) -> NDArray[np.float64]:
    """Return what decides how a frame becomes a coarse contrast."""
    return np.array(
        [config.height, config.width, config.frame_bin, config.gradient_bin, config.log_floor]
    )
