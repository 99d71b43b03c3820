# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""From a camera frame to what the streaming estimator needs of it, against a kept reference."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_fger.errors import TareError
from mixtac_fger.features import EventGuide, FramePreparation, mean_contrast
from mixtac_fger.frame_step import frame_maps, frame_step, frame_weights, row_scratch

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_fger.network import FgerNetwork

    F32 = NDArray[np.float32]


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
