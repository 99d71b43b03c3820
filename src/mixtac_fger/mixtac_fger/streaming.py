# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The live estimator: events and frames in as they arrive, a force out per 2 ms window.

All times are on the camera clock [us].

* No reference or no frame yet: no output; `EstimatorStatus.reason` says which.
* A frame arrives late, as all do: the estimate at the centre of its exposure is corrected and the
  correction carried forward. A frame that arrives before its events waits for them; a frame whose
  exposure is not near the time of the events is not used.
* No frames: the force continues on events alone, up to `longest_without_frame_us`; then there is no
  output until the next frame.
* Packets are missing: windows with no data produce no force, windows with incomplete data are
  marked. The state is kept, because a contact does not end with a lost packet; after a hole longer
  than `LONG_HOLE_US`, output resumes with the first frame exposed after it.
* The camera clock goes backwards: the recurrent state is reset and counted; the reference is kept,
  since the gel is still the same; output resumes with the next frame.
* Values that are not finite are never output: the state is reset and counted.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_events.arrays import Events
from mixtac_events.codec import decode, encode
from mixtac_events.windows import WindowSlicer
from mixtac_fger.estimator import Estimate, EstimatorStatus
from mixtac_fger.features import WindowFeatures, correction_lag
from mixtac_fger.frames import FrameEncoder, FrameWorker, TareError
from mixtac_fger.recurrent_network import RecurrentPath

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_fger.frames import EncodedFrame
    from mixtac_fger.weights import LoadedModel


@dataclass(slots=True)
class EstimatorCounts:
    """What the estimator counts; see `EstimatorStatus`."""

    windows: int = 0
    estimates: int = 0
    withheld: int = 0
    incomplete: int = 0
    saturated: int = 0
    frames: int = 0
    frames_dropped: int = 0
    frames_off_clock: int = 0
    resets: int = 0


BACKWARD_US: Final = 20_000
"""A step back beyond this is a restarted clock: packets of one camera come in order."""
LONG_HOLE_US: Final = 100_000
"""A hole beyond this makes the estimate start from the next frame; shorter ones it gets over."""
JUMP_US: Final = 1_000_000
"""A step forward beyond this is a hole also without lost packets: no camera is silent so long."""


class Arrival(Enum):
    """How a packet follows the one before."""

    GOES_ON = 'goes on'
    AFTER_HOLE = 'after a hole'
    STARTS = 'starts a stream, or follows a long hole or a restart of the clock'


class StreamTime:
    """Follows the time of a stream and remembers the stretch that no packet told of.

    Attributes:
        newest_us: Time up to which the stream is known, camera clock [us]; None before the first.
        gaps: Holes, the long ones included.
        restarts: Times the clock went back.
        skipped_us: Camera time in holes that began the estimate anew [us].
    """

    def __init__(self) -> None:
        self.newest_us: int | None = None
        self.gaps = 0
        self.restarts = 0
        self.skipped_us = 0
        self._hole_us = (0, 0)

    def push(self, first_us: int, complete_until_us: int, *, lost_before: bool) -> Arrival:
        """Take the times of a packet and say how it follows.

        Args:
            first_us: Its first event, or `complete_until_us` without one.
            complete_until_us: No event before this time will follow.
            lost_before: Packets directly before it are missing.
        """
        newest = self.newest_us
        if newest is None:
            return self._start(first_us, complete_until_us)
        if complete_until_us < newest - BACKWARD_US:
            self.restarts += 1
            return self._start(first_us, complete_until_us)
        self.newest_us = max(newest, complete_until_us)
        step = first_us - newest
        if step <= 0 or not (lost_before or step > JUMP_US):
            return Arrival.GOES_ON
        self.gaps += 1
        if step > LONG_HOLE_US:
            self.skipped_us += step
            return self._start(first_us, complete_until_us)
        self._hole_us = newest, first_us
        return Arrival.AFTER_HOLE

    def covered(self, end_us: int, width_us: int) -> tuple[bool, bool]:
        """Return whether packets told of anything, and of everything, in a window.

        Args:
            end_us: End of the window.
            width_us: Width of it.
        """
        begin, end = self._hole_us
        missing = min(end_us, end) - max(end_us - width_us, begin)
        return missing < width_us, missing <= 0

    def forget(self) -> None:
        """Have the next packet start a stream."""
        self.newest_us = None

    def _start(self, first_us: int, complete_until_us: int) -> Arrival:
        self.newest_us = complete_until_us
        # Of what was before the first event nothing is known.
        self._hole_us = (first_us - JUMP_US, first_us)
        return Arrival.STARTS


TARE_WINDOWS = 100
"""Estimates that must all be near zero before a tare is allowed."""
WAITING_FRAMES = 4
"""Encoded frames that wait for the next window; of more the oldest are dropped."""
SATURATION_PER_US = 10
"""Events per microsecond beyond which the sensor's readout loses some: 10 million per second."""
FRAME_AHEAD_US = 100_000
"""Frames exposed later than the events by more than this are on another clock."""
FRAME_BEHIND_US = 1_000_000
"""Frames exposed earlier than the events by more than this are on another clock, or too old."""
NO_LIMIT_US = 2**62


class ForceEstimator:
    """Estimates the normal force live, with memory that does not grow.

    `push_events`, `tare` and `reset` belong to one thread; `push_frame` may be called from another
    when `background_frames` is set.

    Args:
        model: Network with its weights.
        background_frames: Run the frame network in a thread; else `push_frame` does the work.
        force_scale: Multiplies the estimates; from the sensor's calibration.
        contact_threshold_n: Estimates above this count as contact, in which `tare` refuses [N].
        longest_without_frame_us: Age of the latest frame beyond which no force is given [us].
    """

    def __init__(
        self,
        model: LoadedModel,
        *,
        background_frames: bool = False,
        force_scale: float = 1.0,
        contact_threshold_n: float = 0.15,
        longest_without_frame_us: int = NO_LIMIT_US,
    ) -> None:
        self._config = model.config
        self._longest_us = longest_without_frame_us
        self._saturation = SATURATION_PER_US * model.config.window_us
        self._scale = force_scale
        self._threshold = contact_threshold_n
        self._encoder = FrameEncoder(model.network)
        self._worker = FrameWorker(self._encoder) if background_frames else None
        self._path = RecurrentPath(model.network)
        self._window_features = WindowFeatures(model.config)
        self._features = np.zeros(self._window_features.shape, np.float32)
        self._slicer = WindowSlicer(model.config.window_us)
        self._time = StreamTime()
        self._encoded: deque[EncodedFrame] = deque()
        self._frame: EncodedFrame | None = None
        self._recent: deque[float] = deque(maxlen=TARE_WINDOWS)
        self._since_us = -NO_LIMIT_US
        self._count = EstimatorCounts()

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
            self._keep([encoded])

    def push_events(
        self, events: Events, complete_until_us: int, *, lost_before: bool = False
    ) -> list[Estimate]:
        """Hand over events and get the forces of the windows that they complete.

        Args:
            events: The next events, camera clock; may be empty.
            complete_until_us: No event before this time will follow [us].
            lost_before: Events between the previous call and these are missing.

        Returns:
            In order of time; empty until the estimator is ready.
        """
        if self._worker is not None:
            self._keep(self._worker.results())
        first_us = int(events.t[0]) if len(events) else complete_until_us
        known = self._time.newest_us is not None
        arrival = self._time.push(first_us, complete_until_us, lost_before=lost_before)
        if arrival is Arrival.STARTS and known:
            self._forget()
            self._slicer.reset()
            self._since_us = first_us
        closed = self._slicer.push(events, complete_until_us)
        return [found for end, part in closed if (found := self._window(end, part)) is not None]

    @property
    def deviation(self) -> float | None:
        """Standard deviation of the latest force [N]; None of a model that gives none."""
        deviation = self._path.deviation
        return None if deviation is None else self._scale * deviation

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

    @property
    def reference(self) -> NDArray[np.float32] | None:
        """The no-contact reference (see `FrameEncoder.reference`), to be kept in a file."""
        return self._encoder.reference

    def use_reference(self, reference: NDArray[np.float32]) -> None:
        """Compare frames with a kept reference instead of the first still ones.

        Args:
            reference: Of `reference`, of the same sensor.
        """
        self._encoder.use_reference(reference)

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
        frame, worker, count, time = self._frame, self._worker, self._count, self._time
        reason = self._reason()
        return EstimatorStatus(
            ready=not reason,
            reason=reason,
            windows=count.windows,
            estimates=count.estimates,
            withheld=count.withheld,
            incomplete=count.incomplete,
            saturated=count.saturated,
            frames=count.frames,
            frames_dropped=count.frames_dropped + (worker.dropped if worker else 0),
            frames_off_clock=count.frames_off_clock,
            bad_frames=worker.refused if worker else 0,
            gaps=time.gaps,
            skipped_windows=time.skipped_us // self._config.window_us,
            late_events=self._slicer.late_events,
            resets=count.resets + time.restarts,
            frame_age_us=self._frame_age_us(),
            frame_force=0.0 if frame is None else self._scale * frame.force,
            deviation=-1.0 if self.deviation is None else self.deviation,
        )

    def _frame_age_us(self) -> int:
        if self._frame is None or self._time.newest_us is None:
            return -1
        return self._time.newest_us - self._frame.mid_us

    def _reason(self) -> str:
        encoder, worker = self._encoder, self._worker
        if worker is not None and not worker.alive:
            return 'the frame thread has ended: deactivate and activate the estimator'
        if encoder.reference_complete:
            if self._frame is None:
                return 'waiting for a frame'
            age_us = self._frame_age_us()
            late = age_us > self._longest_us
            return f'no frame for {age_us / 1e6:.1f} s: no force without' if late else ''
        progress = f'{encoder.reference_progress} of {self._config.reference_frames} still frames'
        if encoder.disturbances:
            progress += f', restarted {encoder.disturbances} times by motion'
        if worker is not None and worker.problem:
            progress += f'; {worker.problem}'
        return f'waiting for the no-contact reference: {progress}'

    def _window(self, end_us: int, events: Events) -> Estimate | None:
        count = self._count
        count.windows += 1
        while self._encoded and self._due(self._encoded[0], end_us):
            self._apply(self._encoded.popleft(), end_us)
        if self._frame is None:
            return None
        self._window_features.compute(events, self._frame.guide, self._features)
        force = self._scale * self._path.step(self._features)
        deviation = self.deviation
        if not math.isfinite(force if deviation is None else force + deviation):
            count.resets += 1
            self._forget()
            return None
        age_us = end_us - self._frame.mid_us
        told, complete = self._time.covered(end_us, self._config.window_us)
        if not told or age_us > self._longest_us:
            count.withheld += 1
            return None
        saturated = len(events) > self._saturation
        count.estimates += 1
        count.incomplete += not complete
        count.saturated += saturated
        self._recent.append(force)
        return Estimate(end_us, force, deviation, age_us, complete, saturated)

    def _keep(self, frames: list[EncodedFrame]) -> None:
        self._encoded.extend(frames)
        while len(self._encoded) > WAITING_FRAMES:
            self._encoded.popleft()
            self._count.frames_dropped += 1

    def _due(self, frame: EncodedFrame, end_us: int) -> bool:
        """Return whether the events have come as far as a frame, or never will."""
        return not 0 < frame.mid_us - end_us <= FRAME_AHEAD_US

    def _apply(self, frame: EncodedFrame, end_us: int) -> None:
        """Correct the estimate at the end of the last window by a frame that has arrived since."""
        width = self._config.window_us
        behind_us = end_us - frame.mid_us
        if not -FRAME_AHEAD_US <= behind_us <= FRAME_BEHIND_US:
            self._count.frames_off_clock += 1
            return
        if frame.mid_us < self._since_us or frame.reference != self._encoder.reference_number:
            # Exposed before events were lost, or compared with a reference that was replaced.
            self._count.frames_dropped += 1
            return
        if self._frame is None and self._since_us > -NO_LIMIT_US:
            # Maybe in contact already; a start at zero would take several frames to get over.
            self._path.start_at(frame.force)
        else:
            self._path.correct(frame.feature, correction_lag(end_us - width, frame.mid_us, width))
        self._frame = frame
        self._count.frames += 1

    def _forget(self) -> None:
        self._path.clear()
        self._recent.clear()
        self._encoded.clear()
        self._frame = None


WARM_UP_START_US = 1_000_000


def warm_up(model: LoadedModel) -> list[Estimate]:
    """Run a throw-away estimator on a few frames and packets; seconds at the very first time.

    Returns:
        What it gave: something, as else it would not have been through everything.
    """
    config = model.config
    estimator = ForceEstimator(model)
    for kind in (np.uint8, np.uint16):
        for index in range(config.reference_frames):
            image = np.full((config.height, config.width), 100, kind)
            estimator.push_frame(image, WARM_UP_START_US - 1000 * index)
    t_us = np.arange(WARM_UP_START_US + 1000, WARM_UP_START_US + 11_000, 100, dtype=np.int64)
    zeros = np.zeros(len(t_us), np.uint16)
    packet = encode(
        Events(t_us, zeros, zeros, t_us % 200 == 0), complete_until=WARM_UP_START_US + 12_000
    )
    # As from the middleware: bytes that must not be changed.
    decoded = decode(
        packet.payload.tobytes(),
        packet.encoding,
        packet.time_base,
        width=config.width,
        height=config.height,
    )
    return estimator.push_events(decoded.events, decoded.complete_until)
