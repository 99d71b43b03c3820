# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The live estimator: events and frames in as they arrive, a force out per 2 ms window.

All times are on the camera clock. What happens when:

* No reference or no frame yet: no output; `EstimatorStatus.reason` says which.
* A frame arrives late, as all do: the estimate at the centre of its exposure is corrected and the
  correction carried forward.
* A gap in the stream: counted; the state is kept, as a contact does not end with a lost packet.
* The camera clock goes backwards: the recurrent state is reset and counted; the reference is kept,
  since the gel is still the same; output resumes with the next frame.
* Numbers that are not finite never leave: the state is reset and counted.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_events.windows import RESTART_US, WindowSlicer
from mixtac_fger.errors import TareError
from mixtac_fger.features import WindowFeatures, correction_lag
from mixtac_fger.frame_encoder import FrameEncoder
from mixtac_fger.frame_worker import FrameWorker
from mixtac_fger.recurrent_state import RecurrentPath

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_events.arrays import Events
    from mixtac_fger.frame_encoder import EncodedFrame
    from mixtac_fger.weights import LoadedModel

TARE_WINDOWS = 100
"""Estimates that must all be near zero before a tare is allowed."""


@dataclass(frozen=True, slots=True)
class EstimatorStatus:
    """What the estimator says of itself.

    Attributes:
        ready: Whether windows give forces now.
        reason: Why not; empty when ready.
        windows: Windows closed so far.
        estimates: Forces given so far.
        frames: Frames applied so far.
        frames_dropped: Frames replaced by a newer one before they were encoded.
        bad_frames: Frames of a size that the model does not read (background only).
        gaps: Stretches of windows that were skipped as nothing arrived.
        late_events: Events dropped since their window was closed.
        resets: Times the clock went backwards or the state was not finite.
        frame_age_us: Camera time since the centre of the latest frame's exposure, -1 without one.
        frame_force: Frames-only force of the latest frame [N].
    """

    ready: bool
    reason: str
    windows: int
    estimates: int
    frames: int
    frames_dropped: int
    bad_frames: int
    gaps: int
    late_events: int
    resets: int
    frame_age_us: int
    frame_force: float


class ForceEstimator:
    """Estimates the normal force live, with memory that does not grow.

    `push_events`, `tare` and `reset` belong to one thread; `push_frame` may be called from another
    when `background_frames` is set.

    Args:
        model: Network with its weights.
        background_frames: Run the frame network in a thread; else `push_frame` does the work.
        force_scale: Multiplies the estimates; from the sensor's calibration.
        contact_threshold_n: Estimates above this count as contact, in which `tare` refuses [N].
    """

    def __init__(
        self,
        model: LoadedModel,
        *,
        background_frames: bool = False,
        force_scale: float = 1.0,
        contact_threshold_n: float = 0.15,
    ) -> None:
        self._config = model.config
        self._scale = force_scale
        self._threshold = contact_threshold_n
        self._encoder = FrameEncoder(model.network)
        self._worker = FrameWorker(self._encoder) if background_frames else None
        self._path = RecurrentPath(model.network)
        self._window_features = WindowFeatures(model.config)
        self._features = np.zeros(self._window_features.shape, np.float32)
        self._slicer = WindowSlicer(model.config.window_us)
        self._encoded: deque[EncodedFrame] = deque(maxlen=4)
        self._frame: EncodedFrame | None = None
        self._recent: deque[float] = deque(maxlen=TARE_WINDOWS)
        self._newest_us: int | None = None
        self._windows = self._estimates = self._frames = self._gaps = self._resets = 0

    def push_frame(self, image: NDArray[np.uint16] | NDArray[np.uint8], mid_us: int) -> None:
        """Hand over a frame as it arrives.

        Args:
            image: Intensity, [height, width], any number of bits; not to be changed afterwards.
            mid_us: Centre of the exposure, camera clock [us].

        Raises:
            ImageError: The image has another size (with `background_frames` it is counted in
                `EstimatorStatus.bad_frames` instead).
        """
        if self._worker is not None:
            self._worker.push(image, mid_us)
            return
        encoded = self._encoder.encode(image, mid_us)
        if encoded is not None:
            self._encoded.append(encoded)

    def push_events(self, events: Events, complete_until_us: int) -> list[tuple[int, float]]:
        """Hand over events and get the forces of the windows that they complete.

        Args:
            events: The next events, camera clock; may be empty.
            complete_until_us: No event before this time will follow [us].

        Returns:
            (window end [us], force [N]) in order; empty until the estimator is ready.
        """
        if self._worker is not None:
            self._encoded.extend(self._worker.results())
        if self._newest_us is not None and complete_until_us < self._newest_us - RESTART_US:
            self._restart()
        newest = self._newest_us
        self._newest_us = max(complete_until_us, newest if newest is not None else -(2**62))
        skipped = self._slicer.skipped_windows
        closed = self._slicer.push(events, complete_until_us)
        self._gaps += self._slicer.skipped_windows > skipped
        return [pair for end, part in closed if (pair := self._window(end, part)) is not None]

    def tare(self) -> None:
        """Make the present state zero: the latest frames become the reference.

        Raises:
            TareError: Not ready, in contact, or too few still frames.
        """
        if self._frame is None or not self._recent:
            raise TareError(f'no zero without estimates: {self._reason()}')
        largest = max(self._recent, key=abs)
        if abs(largest) > self._threshold:
            raise TareError(
                f'in contact ({largest:.2f} N within the last {len(self._recent)} windows): release'
                ' the sensor and try again'
            )
        self._encoder.renew_reference()
        self._path.clear()
        self._recent.clear()

    def reset(self) -> None:
        """Start over, as just made: the next still frames become the reference."""
        self._forget()
        self._encoder.forget_reference()

    def close(self) -> None:
        """End the frame thread, if there is one."""
        if self._worker is not None:
            self._worker.close()

    def status(self) -> EstimatorStatus:
        """Return counters and the reason for having no output."""
        frame = self._frame
        reason = self._reason()
        return EstimatorStatus(
            ready=not reason,
            reason=reason,
            windows=self._windows,
            estimates=self._estimates,
            frames=self._frames,
            frames_dropped=self._worker.dropped if self._worker else 0,
            bad_frames=self._worker.refused if self._worker else 0,
            gaps=self._gaps,
            late_events=self._slicer.late_events,
            resets=self._resets,
            frame_age_us=-1 if frame is None else (self._newest_us or 0) - frame.mid_us,
            frame_force=0.0 if frame is None else self._scale * frame.force,
        )

    def _reason(self) -> str:
        encoder = self._encoder
        if encoder.reference_complete:
            return 'waiting for a frame' if self._frame is None else ''
        progress = f'{encoder.reference_progress} of {self._config.reference_frames} still frames'
        if encoder.disturbances:
            progress += f', restarted {encoder.disturbances} times by motion'
        if self._worker is not None and self._worker.problem:
            progress += f'; {self._worker.problem}'
        return f'waiting for the no-contact reference: {progress}'

    def _window(self, end_us: int, events: Events) -> tuple[int, float] | None:
        self._windows += 1
        while self._encoded:
            self._apply(self._encoded.popleft(), end_us)
        if self._frame is None:
            return None
        self._window_features.compute(events, self._frame.guide, self._features)
        force = self._scale * self._path.step(self._features)
        if not math.isfinite(force):
            self._resets += 1
            self._forget()
            return None
        self._estimates += 1
        self._recent.append(force)
        return end_us, force

    def _apply(self, frame: EncodedFrame, end_us: int) -> None:
        """Correct the estimate at the end of the last window by a frame that has arrived since."""
        width = self._config.window_us
        self._path.correct(frame.feature, correction_lag(end_us - width, frame.mid_us, width))
        self._frame = frame
        self._frames += 1

    def _restart(self) -> None:
        self._resets += 1
        self._forget()
        self._slicer.reset()
        self._newest_us = None

    def _forget(self) -> None:
        self._path.clear()
        self._recent.clear()
        self._encoded.clear()
        self._frame = None
