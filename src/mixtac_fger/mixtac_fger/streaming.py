# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The live estimator: it receives events and frames, and returns a force per 2 ms window.

All times are on the camera clock [us].

* No reference or no frame yet: no output; `EstimatorStatus.reason` names what is missing.
* A frame arrives late, as every frame does: the estimate at the centre of its exposure is corrected
  and the correction carried forward. A frame that arrives before its events waits for them; a frame
  whose exposure is not near the time of the events is not used.
* No frames: the force continues on events alone, up to `longest_without_frame_us`; then there is no
  output until the next frame.
* Packets are missing: windows without data produce no force, windows with incomplete data are
  marked. The state is kept, because a contact does not end with a lost packet; after a hole longer
  than `LONG_HOLE_US`, output resumes with the first frame exposed after it.
* The camera clock goes backwards: the recurrent state is reset and counted; the reference is kept,
  since the gel is still the same; output resumes with the next frame.
* Values that are not finite are never output: the state is reset and counted.
"""

from __future__ import annotations

import contextlib
import math
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_core.events.arrays import Events
from mixtac_core.events.windows import WindowSlicer
from mixtac_core.node.images import ImageConversionError
from mixtac_core.node.process import lower_priority
from mixtac_fger.config import ModelError
from mixtac_fger.contact_tracking import ContactSettings, ContactTracker
from mixtac_fger.estimator import Estimate, EstimatorStatus
from mixtac_fger.features import ImageError, correction_lag
from mixtac_fger.reference import TareError, Zero, stored_reference
from mixtac_fger.validity import Reason, Validity

if TYPE_CHECKING:
    from collections.abc import Callable

    from mixtac_fger.estimator import EncodedFrame, Estimator, Image


BACKWARD_US: Final = 20_000
"""A larger step back is a restarted clock, because packets of one camera come in order [us]."""
LONG_HOLE_US: Final = 100_000
"""After a longer hole the estimate starts from the next frame [us]."""
JUMP_US: Final = 1_000_000
"""A larger step forward is a hole even if no packet was lost: no camera is silent so long [us]."""


class StreamTime:
    """Follows the time of a stream and remembers the latest stretch that no packet covered.

    Attributes:
        newest_us: Time up to which the stream is known, camera clock [us]; None before the first.
        restarts: Times the clock went back.
    """

    def __init__(self) -> None:
        self.newest_us: int | None = None
        self.restarts = 0
        self._hole_us = (0, 0)

    def push(self, first_us: int, complete_until_us: int, *, lost_before: bool) -> bool:
        """Add the times of a packet.

        Args:
            first_us: Its first event, or `complete_until_us` without one.
            complete_until_us: No event before this time will follow.
            lost_before: Packets directly before it are missing.

        Returns:
            Whether it starts a stream, or follows a long hole or a restart of the clock.
        """
        newest = self.newest_us
        restarted = newest is not None and complete_until_us < newest - BACKWARD_US
        self.restarts += restarted
        step = 0 if newest is None else first_us - newest
        hole = step > 0 and (lost_before or step > JUMP_US)
        if newest is None or restarted or (hole and step > LONG_HOLE_US):
            # Nothing is known about the time before the first event.
            self.newest_us, self._hole_us = complete_until_us, (first_us - JUMP_US, first_us)
            return True
        self.newest_us = max(newest, complete_until_us)
        if hole:
            self._hole_us = newest, first_us
        return False

    def covered(self, end_us: int, width_us: int) -> tuple[bool, bool]:
        """Return whether packets covered any part of a window, and whether they covered all of it.

        Args:
            end_us: End of the window.
            width_us: Its length.
        """
        begin, end = self._hole_us
        missing = min(end_us, end) - max(end_us - width_us, begin)
        return missing < width_us, missing <= 0


TARE_WINDOWS = 100
"""Number of latest estimates that must be near zero before a tare is allowed."""
WAITING_FRAMES = 64
"""Encoded frames that wait for their events; beyond that the oldest are dropped. On a busy host
events are late by up to two seconds, for which the middleware keeps them."""
SATURATION_PER_US = 10
"""Event rate beyond which the sensor's readout loses some [1/us]: 10 million per second."""
FRAME_AHEAD_US = 100_000
"""Frames exposed later than the events by more than this, and by more than `events_late_us`, are on
another clock [us]."""
FRAME_BEHIND_US = 1_000_000
"""Frames exposed earlier than the events by more than this are too old or on another clock [us]."""
LATE_FRAME_US = 70_000
"""Age of the latest frame above which the deviation grows [us]."""
LATE_N_PER_S = 0.8
"""Growth of the deviation with that age [N/s]: without frames the force of 26 simulated trials
changed by 0.08 N after 0.17 s and by 0.14 N after 0.3 s."""
STALE_FRAME_US = 200_000
"""Default of `ForceEstimator.stale_frame_us`."""
LOWEST_FORCE = -0.5
"""Lowest force of training, with a margin, before `force_scale` [N]."""
HIGHEST_FORCE = 10.0
"""Highest force of training, with a margin, before `force_scale` [N]."""
NO_LIMIT_US = 2**62
UNFETCHED_FRAMES = 16
"""Frames in the frame thread, encoded or waiting; beyond that the oldest are dropped."""
NICENESS = 5
"""Niceness of the frame thread, so that the 500 Hz step wins on a busy CPU."""


class ForceEstimator:
    """Processes a live stream and returns a force per window, in bounded memory.

    All methods must be called from one thread; `push_frame` may be called from another thread if
    `background_frames` is set, and `status` from any.

    Args:
        estimator: Architecture with weights and state, not shared with others.
        background_frames: Encode frames in a thread; otherwise `push_frame` does it.
        force_scale: See below.
        sideways_scale: See below.
        contact_threshold_n: See below.
        longest_without_frame_us: See below.
        stale_frame_us: See below.
        assume_free: Nothing touches the sensor at the start. Otherwise the forces are not valid
            until the reference is a stored one or `tare` has been called.
        tare_on_release: See below.
        contact: Settings of contact detection; None for no contact and no displacement. Ignored if
            the architecture does not detect contacts.

    Attributes:
        size: Columns and rows of the sensor [px].
        window_us: Length of a window [us].
        reference: The no-contact reference; None if the architecture needs none.
        frame: The latest frame that was used; None without one.
        contact: State and place of the contact, and the displacement of the beads; None for none.
        force_scale: Factor of the estimates, from the calibration of the sensor; may be changed at
            any time, as the next three.
        sideways_scale: Factor of sideways force and torsion beside `force_scale`.
        contact_threshold_n: Estimate above which there is contact, and `tare` is rejected [N].
        longest_without_frame_us: Age of the latest frame beyond which there is no force [us].
        stale_frame_us: Age of the latest frame beyond which the force is not valid [us].
        tare_on_release: Tare after each contact, once the sensor has been free and still for 2 s.
        events_late_us: Time that the events have waited for a busy host, which frames do not [us].
    """

    def __init__(
        self,
        estimator: Estimator,
        *,
        background_frames: bool = False,
        force_scale: float = 1.0,
        sideways_scale: float = 1.0,
        contact_threshold_n: float = 0.15,
        longest_without_frame_us: int = NO_LIMIT_US,
        stale_frame_us: int = STALE_FRAME_US,
        assume_free: bool = False,
        tare_on_release: bool = False,
        contact: ContactSettings | None = None,
    ) -> None:
        self.force_scale, self.sideways_scale = force_scale, sideways_scale
        self.tare_on_release = tare_on_release
        self.contact_threshold_n = contact_threshold_n
        self.longest_without_frame_us = longest_without_frame_us
        self.stale_frame_us = stale_frame_us
        self.events_late_us = 0
        self._estimator, reference = estimator, estimator.reference
        self.contact: ContactTracker | None = None
        self.use_contact(contact)
        if reference is not None:
            reference.assume_free = assume_free
        self.reference = reference
        self.size = estimator.width, estimator.height
        self.window_us = estimator.window_us
        self._saturation = SATURATION_PER_US * estimator.window_us
        self._thread = (
            ThreadPoolExecutor(1, 'fger_frames', lower_priority, (NICENESS,))
            if background_frames
            else None
        )
        self._jobs: deque[Future[EncodedFrame | None]] = deque(maxlen=UNFETCHED_FRAMES)
        self._slicer = WindowSlicer(estimator.window_us)
        self._time = StreamTime()
        self._encoded: deque[EncodedFrame] = deque(maxlen=WAITING_FRAMES)
        self._between = False
        self.frame: EncodedFrame | None = None
        self._recent: deque[float] = deque(maxlen=TARE_WINDOWS)
        self._validity = Validity(estimator.width)
        self._reason_now = Reason.TRUSTED
        self._saturated = self._other_camera = False
        self._zero = None if reference is None else Zero(reference)
        self._since_us = -NO_LIMIT_US
        self._count = EstimatorStatus()

    @property
    def frame_force(self) -> float:
        """Frames-only force of the latest frame [N]; 0 without one."""
        return 0.0 if self.frame is None else self.force_scale * self.frame.force

    def push_frame(self, image: Image | Callable[[], Image], mid_us: int) -> None:
        """Add a frame as it arrives.

        Args:
            image: Intensity, [height, width]; uint8, or uint16 with the camera's bits left-aligned;
                must not be changed afterwards. Or a function that returns it, called where frames
                are encoded.
            mid_us: Centre of the exposure, camera clock [us].

        Raises:
            ImageError: The image has another size (with `background_frames` it is counted in
                `EstimatorStatus.bad_frames` instead).
        """
        if self._thread is None:
            self._hold(self._encode(image, mid_us))
            return
        with contextlib.suppress(IndexError):
            # A newer frame replaces the one that waits.
            self._jobs[-1].cancel()
        self._count.frames_dropped += len(self._jobs) == UNFETCHED_FRAMES
        self._jobs.append(self._thread.submit(self._encode, image, mid_us))

    def _encode(self, image: Image | Callable[[], Image], mid_us: int) -> EncodedFrame | None:
        return self._estimator.encode(image() if callable(image) else image, mid_us)

    def drain(self) -> None:
        """Wait until all frames pushed so far are encoded; for runs that must be repeatable."""
        wait(self._jobs)
        self._fetch()

    def push_events(
        self, events: Events, complete_until_us: int, *, lost_before: bool = False
    ) -> list[Estimate]:
        """Process events and return the forces of the windows that they complete.

        Args:
            events: The next events, camera clock; may be empty.
            complete_until_us: No event before this time will follow [us].
            lost_before: Whether events between the previous call and this one are missing.

        Returns:
            Estimates in order of time; empty until the estimator is ready.
        """
        first_us = int(events.t[0]) if len(events) else complete_until_us
        known = self._time.newest_us is not None
        restarts = self._time.restarts
        if self._time.push(first_us, complete_until_us, lost_before=lost_before) and known:
            self._fetch()
            waiting = list(self._encoded)
            self._forget()
            if self._time.restarts == restarts:
                # Frames that wait may lie beyond the hole.
                self._encoded.extend(waiting)
                self._validity.skip()
            else:
                self._validity.clear()
            self._slicer.reset()
            self._since_us = first_us
        closed = self._slicer.push(events, complete_until_us)
        if not (closed and self._between):
            self._fetch()
        self._between = not closed
        if self._between:
            # No force waits for what frames take.
            self._use_frames(self._slicer.open_end_us)
        return [found for end, part in closed if (found := self._window(end, part)) is not None]

    def tare(self) -> None:
        """Set the present force to zero: the latest frames become the reference.

        While the zero is unknown, a release must have been seen since the start, because a contact
            that is present from the beginning cannot be detected.

        Raises:
            TareError: The estimator is not ready, the sensor is in contact, there are too few still
                frames, or the model has no reference.
        """
        self._renew_reference()
        self._validity.forget()

    def _renew_reference(self) -> None:
        if self._zero is None:
            raise TareError(
                'this model has no no-contact reference', remedy='subtract the force at rest'
            )
        if self.frame is None or not self._recent:
            raise TareError(f'there are no estimates yet: {self._reason()}')
        self._fetch()
        latest = self._encoded[-1] if self._encoded else self.frame
        forces = [self.force_scale * each for each in self._recent]
        self._zero.renew(latest.picture, forces, self.contact_threshold_n)
        self._other_camera = False
        self._estimator.clear()
        self._recent.clear()

    def load_reference(self, name: str) -> None:
        """Use the stored reference of the connected camera from now on, if there is one.

        Args:
            name: As for `stored_reference`, whose errors it raises.
        """
        if stored_reference(name, self.reference) is not None:
            self._other_camera = False
            self._start_over()

    def change_camera(self) -> None:
        """Forget the zero: another camera was connected."""
        if self.reference is not None:
            self.reference.forget()
            self.reference.assume_free = False
        self._start_over()
        self._validity.forget()
        self._estimator.change_sensor()
        self._other_camera = True

    def _start_over(self) -> None:
        self._forget()
        self._validity.clear()
        if self._zero is not None:
            self._zero.restart()

    def use_contact(self, settings: ContactSettings | None) -> None:
        """Find contacts with these settings from now on, if the architecture can; None ends it."""
        before = None if self.contact is None else self.contact.settings
        if self._estimator.finds_contact and settings != before:
            grid = self._estimator.flow.shape[0], self._estimator.flow.shape[1]
            self.contact = None if settings is None else ContactTracker(settings, grid)
            self._estimator.find_contacts(None if settings is None else settings.scale)

    def close(self) -> None:
        """End the frame thread, if there is one."""
        if self._thread is not None:
            self._thread.shutdown(cancel_futures=True)

    def status(self) -> EstimatorStatus:
        """Return counters and the reason for having no output."""
        return replace(
            self._count,
            late_events=self._slicer.late_events,
            resets=self._count.resets + self._time.restarts,
            reason=self._reason(),
            validity=self._reason_now.name,
            zero_drift=self.force_scale * self._zero.drift if self._zero is not None else 0.0,
            gel_growth=self._estimator.growth,
        )

    def _reason(self) -> str:
        reference, problem = self.reference, self._count.problem
        if reference is None or reference.array is not None:
            if self.frame is not None:
                age_us = (self._time.newest_us or 0) - self.frame.mid_us
                late = age_us > self.longest_without_frame_us
                return f'no frame for {age_us / 1e6:.1f} s, so no force is given' if late else ''
            waiting = 'a frame'
        else:
            still = f'{reference.progress} of {reference.frames} still frames'
            waiting = f'the no-contact reference: {still}'
        return f'waiting for {waiting}' + (f'; {problem}' if problem else '')

    def _window(self, end_us: int, events: Events) -> Estimate | None:
        count = self._count
        self._use_frames(end_us)
        if self.frame is None:
            return None
        raw, spread = self._estimator.step(events, end_us)
        age_us = end_us - self.frame.mid_us
        force = self.force_scale * raw
        if spread is not None:
            late = LATE_N_PER_S * 1e-6 * max(age_us - LATE_FRAME_US, 0)
            spread = math.hypot(spread, self._estimator.force_unit * late)
        deviation = None if spread is None else self.force_scale * spread
        if not math.isfinite(force if deviation is None else force + deviation):
            count.resets += 1
            self._forget()
            self._validity.clear()
            return None
        covered, complete = self._time.covered(end_us, self.window_us)
        self._validity.window(end_us, events, complete=complete)
        if not covered or age_us > self.longest_without_frame_us:
            count.withheld += 1
            return None
        saturated = len(events) > self._saturation
        self._saturated |= saturated
        self._recent.append(raw)
        reason = self._reason_now = self._distrust(raw, age_us)
        count.saturated += saturated
        found = None
        if self.contact is not None:
            found = self.contact.window(end_us, force, self._estimator.flow)
        shear = self._estimator.shear
        if shear is not None:
            shear = shear.scaled(self.force_scale * self.sideways_scale)
        return Estimate(end_us, force, deviation, age_us, complete, saturated, reason, found, shear)

    def _fetch(self) -> None:
        """Process the results of the frame thread."""
        while self._jobs and self._jobs[0].done():
            job = self._jobs.popleft()
            if job.cancelled():
                self._count.frames_dropped += 1
                continue
            try:
                self._hold(job.result())
            except (ImageError, ImageConversionError) as error:
                self._count.bad_frames += 1
                self._count.problem = str(error)
            except Exception as error:
                raise ModelError(f'the estimator failed at a frame: {error!r}') from error

    def _hold(self, frame: EncodedFrame | None) -> None:
        """Let an encoded frame wait for its events; None is a frame of an incomplete reference."""
        if frame is not None:
            self._count.frames_dropped += len(self._encoded) == WAITING_FRAMES
            self._encoded.append(frame)

    @property
    def _most_ahead_us(self) -> int:
        """Return by how much a frame on the clock of the events may be ahead of them [us]."""
        return FRAME_AHEAD_US + self.events_late_us

    def _use_frames(self, end_us: int) -> None:
        """Use the frames that have arrived before the window that ends at a time."""
        while self._encoded and not 0 < self._encoded[0].mid_us - end_us <= self._most_ahead_us:
            # Its events are there, or never will be.
            self._apply(self._encoded.popleft(), end_us)

    def _distrust(self, raw: float, age_us: int) -> Reason:
        """Return why a force cannot be trusted, before `force_scale` [N]."""
        reference = self.reference
        if self._other_camera:
            return Reason.OTHER_CAMERA
        if reference is not None and not reference.known:
            return Reason.ZERO_UNKNOWN
        reason = self._validity.reason
        if reason is not Reason.TRUSTED:
            return reason
        if not LOWEST_FORCE <= raw / self._estimator.force_unit <= HIGHEST_FORCE:
            return Reason.OUT_OF_RANGE
        if self._saturated:
            return Reason.SATURATED
        return Reason.STALE if age_us > self.stale_frame_us else Reason.TRUSTED

    def _apply(self, frame: EncodedFrame, end_us: int) -> None:
        """Correct the estimate at the end of the last window by a frame that has arrived since."""
        behind_us = end_us - frame.mid_us
        if not -self._most_ahead_us <= behind_us <= FRAME_BEHIND_US:
            self._count.frames_off_clock += 1
            return
        reference = self.reference
        replaced = reference is not None and frame.reference != reference.number
        earlier = self.frame is not None and frame.mid_us <= self.frame.mid_us
        if frame.mid_us < self._since_us or replaced or earlier:
            # Exposed before events were lost, or before the frame before; or compared with a
            # reference that was replaced.
            self._count.frames_dropped += 1
            return
        kept, picture = reference is not None and reference.kept, frame.picture
        self._validity.frame(frame.mid_us, frame.contrast, picture)
        if picture is not None and self._zero is not None:
            light = abs(self.force_scale * frame.force) < self.contact_threshold_n
            self._zero.frame(picture, frame.force, light=light)
        if self.frame is None and (kept or self._since_us > -NO_LIMIT_US):
            # Something may touch the sensor already.
            self._estimator.start_at(frame)
        else:
            width = self.window_us
            lag = correction_lag(end_us - width, frame.mid_us, width)
            self._estimator.correct(frame, lag)
        self.frame = frame
        if self.contact is not None and frame.touch is not None:
            self.contact.frame(frame.mid_us, frame.touch)
        self._saturated = False
        self._count.frames += 1
        if self.tare_on_release and self._zero is not None and self._zero.due:
            with contextlib.suppress(TareError):
                self._renew_reference()
                # The sensor is the same, and so are its usual rates and noise.
                self._validity.clear()

    def _forget(self) -> None:
        """Forget the stream, but not what `_validity` knows of it."""
        self._estimator.clear()
        self._recent.clear()
        self._encoded.clear()
        self.frame = None
        if self.contact is not None:
            self.contact.clear()


WARM_UP_STEP_US = 10_000


def warm_up(estimator: Estimator) -> list[Estimate]:
    """Run an estimator on a few frames and events, so that everything is compiled and loaded.

    It takes seconds the very first time. The estimator must not be used afterwards. Packets have a
    `warm_up` of their own (`mixtac_core.events.codec`).

    Returns:
        The estimates; if the list is empty, a part was not run.
    """
    feed, found = ForceEstimator(estimator, contact=ContactSettings()), []
    (width, height), random = feed.size, np.random.default_rng(0)
    frames = 1 if estimator.reference is None else estimator.reference.frames
    for start_us in range(0, 2 * frames * WARM_UP_STEP_US, WARM_UP_STEP_US):
        image = random.integers(99, 102, (height, width)).astype(np.uint8)
        wide = start_us % (2 * WARM_UP_STEP_US)
        feed.push_frame(image.astype(np.uint16) if wide else image, start_us)
        t_us = np.arange(start_us, start_us + WARM_UP_STEP_US, 100, dtype=np.int64)
        zeros = np.zeros(len(t_us), np.uint16)
        events = Events(t_us, zeros, zeros, t_us % 200 == 0)
        found += feed.push_events(events, start_us + WARM_UP_STEP_US)
    return found
