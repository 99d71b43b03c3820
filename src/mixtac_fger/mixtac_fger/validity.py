# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whether a force can be trusted, and why not.

Six groups of checks, none of which knows a particular fault:

* The picture: a pressed gel is the gel of the reference, displaced and nothing else. What is left
  after the reference is displaced, tile by tile, no contact explains.
* Frames and events: the change from one frame to the next is what the events between them say, in
  size and in pattern.
* The estimate: the frame's force is the force that was estimated at the centre of its exposure.
* Rates: where the sensor at rest has noise, neither ON nor OFF events stop, pause or become half as
  many, and at rest they have the usual share each.
* Noise: its pattern is that of the sensor's pixels (`noise_pattern`).
* Repetition: noise never makes the same frame twice, nor the same events at the same intervals,
  nor many events at one time, nor the same number of them again and again.

Thresholds lie outside of all that 44 simulated trials without a fault show (presets `easy`,
`paper_like` and `hard`, 0 to 10 N, blows, vibrations; 5.6 minutes), those of pictures of all that
631 show, most by a factor of two or more; none was chosen by a fault. `mixtac experiments faults`
counts false alarms on other trials.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mixtac_fger.comparisons import MOST_MARKS, add_signs, agreement, marks
from mixtac_fger.motion_agreement import MotionAgreement, pair_of
from mixtac_fger.noise_pattern import (
    LEAST_RATE,
    MEMORY,
    RARE,
    SPAN,
    NoisePattern,
    least_number,
)
from mixtac_fger.pictures import picture_findings
from mixtac_fger.reasons import Reason
from mixtac_fger.recent_events import Known, RecentWindows

if TYPE_CHECKING:
    from mixtac_events.arrays import Events
    from mixtac_fger.pictures import PictureFigures

F32 = NDArray[np.float32]

MOST_CLIPPED = 0.01
"""Share of the picture that may be white beyond what was at the start; without a fault none is."""
FEW_BINS, STRONG_BINS = 3, 10
"""Bins with a strong change from which on events have to tell of it: the first of those of
`LONGEST_COMPARISON` frames, the second at once; of twice as many, or if events tell of the
reverse, it counts twice."""
LEAST_SLOPE = 0.2
"""Events per pixel and log unit of change; without a fault 1.1 to 4, the inverse of a threshold.
Two of 44 sensors, with the slowest pixels of `hard`, have 0.4 and more. Of 4,577 slopes of 95
trials, 338 of them of less than `STRONG_BINS`, the lowest is 0.5."""
LEAST_SLOPE_OF_OWN = 0.25
"""The same over the sensor's own, without a fault 0.39 and more."""
JUDGEMENTS = 2
"""Slopes in a row that have to be too low; without a fault a single one of few bins."""
LONGEST_COMPARISON = 12
"""Frames after which the comparison of frames and events starts over."""
LEAST_ONE_WAY = 0.7
"""ON less OFF events per bin over all events, below which something moved to and fro between two
frames, of which they tell little: a weak vibration. In motion 0.7 and more, mostly 0.9."""
LEAST_BY_CHANCE = 0.95
"""The same where noise is dense, over what chance leaves of n events per bin, about the inverse
root of 1 + n pi / 2. In noise 1.01 and more (37 trials), in weak vibrations 0.9 and less."""
BUSY_PER_MS = 750
"""Rate of a blow [events/ms]: its motion during an exposure is no fault."""
BUSY_MARGIN_US = 8_000
"""Half an exposure and more, before and after a comparison [us]."""
MOST_UNTOLD, STILL, UNTOLD_FRAMES, UNTOLD_BLOWS = 3.0, 1.3, 3, 5
"""Events over those at rest while the change of frames over that at rest is below the second, in so
many frames in a row, or so many with a blow each between them and the one before; without a fault
2.3 in three frames (66 trials)."""
FEW_EVENTS = 10
"""Events between two frames that are no motion, however quiet the sensor is."""
UNTOLD = UNTOLD_FRAMES * UNTOLD_BLOWS
MOST_RATE = 4.0
"""Rate over that at rest in all windows between frames that are still."""
MOST_DISAGREEMENT, DISAGREEING_FRAMES = 1.5, 3
"""Frame force less estimate over `disagreement_scale`, the mean of so many frames; without a fault
up to 1.1, but for two trials of vibration in which the estimate was wrong by 0.5 N."""
LOWEST_FORCE, HIGHEST_FORCE = -0.5, 10.0
"""Range of the forces in training with a margin, before `force_scale` [N]."""
HOLD_FRAMES = 5
"""Frames without a finding after which a force is trusted again."""
FALL, RISE = 0.2, 0.002
"""Shares of a new value by which levels of noise follow it."""
RESTS_KNOWN = 25
"""Frames at rest after which it is known what is usual, and from which on that follows slowly."""
MOST_LEANING, RESTS_LEANING, LEAST_LEANING, QUIET = 0.08, 5, 200, 1.2
"""Share of ON events at rest less the usual one, the mean of so many frames with so many events and
at most so many times the usual ones; without a fault 0.053 at most (42 trials)."""
AT_REST = 1.5
"""Events over those at rest up to which a frame without motion counts as rest."""
FRAMES_KNOWN, ROWS_APART = 128, 8
"""Frames that are known again, by every eighth row."""
STRETCHES_KNOWN = 256
"""Stretches of events that are known again, by their marks."""
MOST_AGAIN, FORGOTTEN = 2.5, 0.2
"""Marks that are known again, of which each stretch forgets a part; without a fault 1 at most, in
218 stretches of real events, none in 7,776 of simulated ones."""
LEAST_RECENT = 0.6
"""ON, or OFF, events of the latest 100 ms over those at rest; without a fault 0.78 and more (42
trials)."""
LONGEST_PAUSE = 5.0
"""Longest pause between two events of a stretch over its mean at rest; without a fault 2.6 at most
(95 trials), 3.5 in real events."""
MOST_TWICE = 8
"""Events of a stretch that are the one before once more; without a fault 1 at most."""
LEAST_EVEN = 40
"""Events of a window from which on ten in a row, of a sensor whose noise comes and goes, never have
the same number or one more: what is so even is a limit of their rate, until a window has more."""
NO_LIMIT = 2**62
EVENTS_TIMED, LEAST_TIMES = 80, 8
"""Events from which on they have to have so many different times in a stretch: the camera gives
each its own, or one to those of a row."""


def disagreement_scale(force: float) -> float:
    """Return how far the frame's force and an estimate may differ [N]."""
    return 0.1 + 0.3 * abs(force)


class Validity:
    """Follows frames and windows, and says why the force cannot be trusted.

    Memory is bounded; the work per frame is that of a few thousand additions, that per window does
    not depend on what came before.

    Args:
        window_us: Length of a window [us].
        width: Columns of the sensor [px].
    """

    def __init__(self, window_us: int, width: int) -> None:
        self._window_us, self._width = window_us, width
        self._blow = BUSY_PER_MS * window_us // 1000
        self._windows = RecentWindows(window_us)
        self._room = np.empty(MOST_MARKS, np.uint64)
        self.forget()

    def forget(self) -> None:
        """Forget the sensor, and what is usual of it."""
        self._rest = [0.0, 0.0]  # ON and OFF events per window
        self._rests = 0
        self._leaning: deque[float] = deque(maxlen=RESTS_LEANING)
        self._pause, self._usual_pause = 0, 0.0  # between two events [us]
        self._noise = self._murmur = self._slope = 0.0
        self._white: float | None = None
        self._varies, self._limit = False, NO_LIMIT
        self._pattern = NoisePattern(self._width, self._window_us)
        self._held: dict[Reason, int] = {}
        self.clear()

    def clear(self) -> None:
        """Forget the stream: a restart of its clock. Noise levels are kept."""
        self._windows.clear()
        self._held.clear()
        self._before: tuple[int, F32 | None] = (0, None)
        self._anchor: F32 | None = None
        self._signs = np.zeros((0, 0), np.float32)
        self._stretch = self._age = self._untold = self._low = 0
        self._recent = [self._pattern.windows * each for each in self._rest]
        self._busy = self._vibrating = self._foreign = self._unlike = self._spoilt = False
        self._agreement = MotionAgreement()
        self._disagreements: deque[float] = deque(maxlen=DISAGREEING_FRAMES)
        self._frames: deque[int] = deque(maxlen=FRAMES_KNOWN)
        self._marks, self._again = Known(STRETCHES_KNOWN, MOST_MARKS), 0.0
        if self._pattern.missing:
            self._held[Reason.EVENTS_DISAGREE] = HOLD_FRAMES

    def skip(self) -> None:
        """Go on after a hole in the stream: what is wrong stays wrong until it is right."""
        self._start_over()
        self._windows.clear()
        self._stretch = self._untold = self._low = 0
        self._vibrating = False
        self._disagreements.clear()

    @property
    def reason(self) -> Reason:
        """Why not, by the latest frames and windows; `TRUSTED` if nothing was found."""
        return min(self._held) if self._held else Reason.TRUSTED

    @property
    def noise_known(self) -> bool:
        """Whether the noise at rest is known; until then events are compared with frames only."""
        return self._pattern.known

    def window(self, end_us: int, events: Events, *, complete: bool) -> None:
        """Take a window.

        Args:
            end_us: Its end, camera clock [us].
            events: Its events.
            complete: Whether all of its packets arrived.
        """
        if not complete:
            self._start_over()
            return
        self._windows.add(end_us, events)
        number = self._windows.numbers[-1]
        if number > self._limit:
            self._limit = NO_LIMIT
        elif number >= self._limit - 1:
            self._held[Reason.EVENTS_DISAGREE] = HOLD_FRAMES
        self._stretch += 1
        if self._stretch == self._pattern.windows:
            self._stretch = 0
            self._judge_stretch()

    def _judge_stretch(self) -> None:
        """Look at the events of the latest windows alone."""
        count = self._pattern.windows
        latest = self._windows.latest(count)
        stretch = self._windows.events(latest)
        found, brighter, twice, times, pause = marks(stretch, self._room)
        for sign, number in enumerate((brighter, len(stretch) - brighter)):
            usual = count * self._rest[sign]
            self._recent[sign] += (number - self._recent[sign]) / MEMORY
            few = SPAN * self._recent[sign] < least_number(SPAN * usual, RARE, LEAST_RECENT)
            silent = number < least_number(usual, RARE, LEAST_RATE)
            if silent or (few and self._rests >= RESTS_KNOWN):
                self._held[Reason.EVENTS_MISSING] = HOLD_FRAMES
        self._again += self._marks.add(self._room[:found]) - FORGOTTEN * self._again
        wrong = self._again > MOST_AGAIN or twice > MOST_TWICE
        wrong |= len(stretch) >= EVENTS_TIMED and times < LEAST_TIMES
        numbers = self._windows.numbers[latest]
        least, most = min(numbers), max(numbers)
        ends = self._windows.ends_us[latest]
        # Of a blow not all events are kept.
        if most <= self._blow and ends[-1] - ends[0] == (count - 1) * self._window_us:
            # That of a few events says little.
            self._pause = pause if len(stretch) >= EVENTS_TIMED else 0
            if pause > LONGEST_PAUSE * self._usual_pause > 0.0:
                self._held[Reason.EVENTS_MISSING] = HOLD_FRAMES
        even = most <= least + 1
        if self._varies and even and least >= LEAST_EVEN and count > 1:
            self._limit, wrong = most, True
        self._varies |= not even and most <= 3 * least
        # A blow is not noise, wherever it is.
        if most <= self._blow:
            self._pattern.judge(stretch)
        if self._pattern.silent:
            self._held[Reason.EVENTS_MISSING] = HOLD_FRAMES
        if self._pattern.storm:
            self._held[Reason.EVENTS_WITHOUT_MOTION] = HOLD_FRAMES
        self._foreign = wrong or self._pattern.missing
        if self._foreign:
            self._held[Reason.EVENTS_DISAGREE] = HOLD_FRAMES

    def frame(
        self,
        mid_us: int,
        contrast: F32 | None,
        picture: PictureFigures | None,
        force: float,
        estimate: float | None,
        *,
        vibrating: bool = False,
    ) -> None:
        """Take a frame that corrects the estimate.

        Args:
            mid_us: Centre of its exposure, camera clock [us].
            contrast: Its coarse log contrast, float32 [rows, columns]; None if unknown.
            picture: Comparison with the reference; None without one.
            force: Its force [N].
            estimate: Estimate at the centre of its exposure [N]; None if there is none.
            vibrating: The force vibrates, and the skin moves to and fro within an exposure: the
                frame is neither compared with the events nor a picture of rest.
        """
        blow = self._is_blow(mid_us, mid_us)
        found = set() if picture is None else self._look(picture, blow=blow)
        if vibrating and not self._vibrating:
            # What was found was the vibration, and this is the first frame to lead the estimate.
            if not self._foreign:
                self._held.pop(Reason.EVENTS_DISAGREE, None)
            if not self._pattern.storm:
                self._held.pop(Reason.EVENTS_WITHOUT_MOTION, None)
            self._disagreements.clear()
            self._untold = self._low = 0
            self._agreement, estimate = MotionAgreement(), None
        self._vibrating = vibrating
        if contrast is not None:
            found |= self._compare(mid_us, contrast)
        # Also where no two frames can be compared: packets are lost again and again.
        if self._agreement.apart or self._agreement.late:
            found.add(Reason.EVENTS_DISAGREE)
        if estimate is not None and not blow:
            scale = disagreement_scale(max(abs(force), abs(estimate)))
            self._disagreements.append((force - estimate) / scale)
            total = abs(sum(self._disagreements))
            if total > MOST_DISAGREEMENT * DISAGREEING_FRAMES:
                found.add(Reason.EVENTS_DISAGREE)
        for reason, left in list(self._held.items()):
            if left > 1:
                self._held[reason] = left - 1
            else:
                del self._held[reason]
        self._held.update(dict.fromkeys(found, HOLD_FRAMES))

    def _look(self, picture: PictureFigures, *, blow: bool) -> set[Reason]:
        """Return what is wrong with the picture of a frame."""
        # A contact, which widens the limits, does not make good what was wrong before it.
        found = picture_findings(picture._replace(displacement=0.0) if self._spoilt else picture)
        if self._white is None:
            self._white = picture.clipped
        if picture.clipped > self._white + MOST_CLIPPED:
            found.add(Reason.LIGHT_CHANGED)
        else:
            # A contact may hide what is white.
            self._white += RISE * max(picture.clipped - self._white, 0.0)
        before, self._unlike = self._unlike, bool(found)
        if blow and not before:
            # A mixture of pictures, unless the next one is like it.
            return set()
        self._spoilt = bool(found)
        return found

    def _compare(self, mid_us: int, contrast: F32) -> set[Reason]:
        """Return what the frame says about the events since the frames before it."""
        before_us, before = self._before
        self._before = mid_us, contrast
        mark = hash(contrast[::ROWS_APART].tobytes())
        frozen = mark in self._frames
        self._frames.append(mark)
        if frozen:
            return {Reason.FRAME_FROZEN}
        if before is None or self._anchor is None:
            self._anchor, self._signs, self._age = contrast, np.zeros_like(contrast), 0
            self._busy = self._is_busy(mid_us, mid_us)
            return set()
        chosen = self._between(before_us, mid_us)
        if chosen is None:
            self._start_over()
            return set()
        told, events = np.empty_like(contrast), self._windows.events(chosen)
        size = self._width // contrast.shape[1]
        # At once: a call of compiled code takes longer than the few events of a window.
        brighter, net = add_signs(events, size, told, self._signs)
        self._age += 1
        busy = self._is_busy(before_us, mid_us)
        self._busy |= busy
        signs = brighter, len(events) - brighter
        found = set()
        if not self._vibrating:
            found = self._judge_pair(before, contrast, told, chosen, signs, net)
        *_, strong, slope = agreement(self._anchor, contrast, self._signs)
        ended = strong >= STRONG_BINS or self._age >= LONGEST_COMPARISON
        if ended and strong >= FEW_BINS and not self._busy:
            few = strong < STRONG_BINS
            low = slope < max(LEAST_SLOPE, 0.0 if few else LEAST_SLOPE_OF_OWN * self._slope)
            sure = strong >= 2 * STRONG_BINS or slope < -LEAST_SLOPE
            self._low = self._low + (1 + sure) if low else 0
            if not low and not few:
                self._slope += (slope - self._slope) * (FALL if self._slope else 1.0)
            if self._low >= JUDGEMENTS:
                self._agreement.contradict()
        if ended:
            self._anchor, self._age, self._busy = contrast, 0, busy
            self._signs[:] = 0.0
        return found

    def _judge_pair(
        self,
        before: F32,
        contrast: F32,
        told: F32,
        chosen: slice,
        signs: tuple[int, int],
        net: float,
    ) -> set[Reason]:
        """Compare two frames in a row; follows the noise of frames and events at rest."""
        if Reason.EVENTS_MISSING in self._held:
            # Silence is no rest: it would become what is usual.
            return set()
        size = self._width // told.shape[1]
        # What a few events make: they come and go.
        few = math.sqrt(FEW_EVENTS / told.size) / (size * size)
        pair = pair_of(before, contrast, told, self._noise, max(self._murmur, few))
        change, events, correlation = pair.change, pair.events, pair.correlation
        if not self._noise:
            self._noise, self._murmur = change, events
        self._noise += (change - self._noise) * (FALL if change < self._noise else RISE)
        self._murmur += (events - self._murmur) * (FALL if events < self._murmur else RISE)
        murmur = max(self._murmur, few)
        numbers = self._windows.numbers[chosen]
        rates = [number / len(numbers) for number in signs]
        still = change < STILL * self._noise
        alone = events * math.sqrt(max(1.0 - correlation * correlation, 0.0))
        # A blow makes many events in a few windows, a storm in all of them.
        most = MOST_RATE * sum(self._rest)
        many = 0.0 < most < min(numbers)
        untold = still and (many or alone > MOST_UNTOLD * murmur)
        blow = not many and max(numbers) > self._blow
        # Whole numbers, so that thirds and fifths add up.
        step = UNTOLD_FRAMES if blow else UNTOLD_BLOWS
        self._untold = self._untold + step if untold else 0
        rest = still and not many and alone < AT_REST * murmur
        usual = AT_REST * sum(self._rest)
        noise = min(sum(rates), usual) if self._rests else sum(rates)
        by_chance = 1.0 / math.sqrt(1.0 + noise * len(numbers) / told.size * math.pi / 2.0)
        one_way = net >= min(LEAST_ONE_WAY, LEAST_BY_CHANCE * by_chance) * sum(numbers)
        # No vibration that frames do not show, unless there always is one.
        rest &= one_way or sum(rates) <= usual
        quiet = self._rests >= RESTS_KNOWN and rest and sum(rates) < QUIET * sum(self._rest)
        if quiet and sum(signs) >= LEAST_LEANING:
            self._leaning.append(rates[0] / sum(rates) - self._rest[0] / sum(self._rest))
        lean = abs(sum(self._leaning)) > MOST_LEANING * RESTS_LEANING
        if rest and not lean:
            latest = slice(chosen.stop - self._pattern.windows, chosen.stop)
            if latest.start >= 0:
                self._pattern.learn(self._windows.events(latest), (told.shape[0], told.shape[1]))
            self._rests += 1
            share = 1.0 / self._rests if self._rests <= RESTS_KNOWN else RISE
            self._rest = [a + (b - a) * share for a, b in zip(self._rest, rates, strict=True)]
            if self._pause:
                share = share if self._usual_pause else 1.0
                self._usual_pause += (self._pause - self._usual_pause) * share
        found = {Reason.EVENTS_WITHOUT_MOTION} if self._untold >= UNTOLD else set()
        if lean:
            found.add(Reason.EVENTS_DISAGREE)
        self._agreement.pair(pair, usable=one_way and not self._busy)
        if self._agreement.certain:
            self._pattern.confirm()
            if lean:
                self._leaning.clear()
                self._rests = 0
        return found

    def _between(self, start_us: int, end_us: int) -> slice | None:
        """Return the windows between the centres of two exposures; None if some are missing."""
        half = self._window_us // 2
        chosen = self._windows.between(start_us + half, end_us + half)
        count, whole = chosen.stop - chosen.start, (end_us - start_us) // self._window_us
        return chosen if count > 0 and whole - 1 <= count <= whole + 1 else None

    def _is_busy(self, start_us: int, end_us: int) -> bool:
        """Return whether there was a vibration, or a blow, in a comparison or at its ends."""
        return self._vibrating or self._is_blow(start_us, end_us)

    def _is_blow(self, start_us: int, end_us: int) -> bool:
        """Return whether there was a blow between two times, or within half an exposure of them."""
        near = self._windows.between(start_us - BUSY_MARGIN_US, end_us + BUSY_MARGIN_US)
        return max(self._windows.numbers[near], default=0) > self._blow

    def _start_over(self) -> None:
        self._before, self._anchor = (0, None), None
        self._agreement.skip()
