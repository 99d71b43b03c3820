# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A virtual camera that repeats one stretch of stream, encoded once: load without computation.

For tests and benchmarks of whatever reads the camera: at each moment it is known which events were
sent, and sending them costs a copy. The first event of every period is a marker at pixel `MARKER`,
where no other event is.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mixtac_events.arrays import Events
from mixtac_sim.grids import HEIGHT, WIDTH
from mixtac_sim.pixels.aps import ApsFrame
from mixtac_sim.usb import endpoints
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.usb.words import (
    Blocks,
    ImuReading,
    ImuSettings,
    ReadoutSettings,
    WordEncoder,
    frame_blocks,
    imu_blocks,
)

WRAP_US: Final = 0x8000
STEP_US: Final = 32
MARKER: Final = (0, 0)
MARKER_US: Final = 64
_RESET_LEVEL: Final = 900
_EXPOSURE_US: Final = 4000
_READOUT_US: Final = 6000
_WRAP_WORD: Final = 0x7000
_MAX_WRAPS: Final = 0xFFF
_NEAR_US: Final = 128 * STEP_US
_READOUT: Final = ReadoutSettings(
    region=(0, 0, WIDTH - 1, HEIGHT - 1),
    exposure_cycles=120_960,
    global_shutter=True,
    orientation=4,
)
_UNIT: Final = ImuSettings(accel=True, gyro=True, temperature=True, accel_scale=1, gyro_scale=1)


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """Stream words of one period, and where each step of time ends in them.

    Attributes:
        words: ``uint16`` stream words; the last is the time wrap that ends the period.
        ends: One past the last word of each step of `STEP_US` [int64].
        events: Events of a period, on a clock [us] that is zero at its start.
        frames: Frames per period.
        readings: Inertial samples per period.
    """

    words: NDArray[np.uint16]
    ends: NDArray[np.int64]
    events: Events
    frames: int
    readings: int

    @property
    def period_us(self) -> int:
        """Length of a period [us]."""
        return len(self.ends) * STEP_US


def make_pattern(
    events_per_s: float,
    *,
    events_per_row: float = 1.0,
    frame_interval_us: int = 0,
    reading_interval_us: int = 0,
    wraps: int = 2,
    seed: int = 0,
) -> Pattern:
    """Return a period of random events with frames and inertial samples between them.

    Args:
        events_per_s: Mean rate of events [1/s].
        events_per_row: Mean number of events that share a row and a time.
        frame_interval_us: Time between frames [us], 0 for none.
        reading_interval_us: Time between inertial samples [us], 0 for none.
        wraps: Length of the period in wraps of the camera's 15-bit time.
        seed: Of the random events.
    """
    rng = np.random.default_rng(seed)
    period_us = wraps * WRAP_US
    events = _random_events(rng, events_per_s, events_per_row, period_us)
    reset = np.full((HEIGHT, WIDTH), _RESET_LEVEL, np.uint16)
    signal = rng.integers(1, _RESET_LEVEL, (HEIGHT, WIDTH)).astype(np.uint16)
    frames = []
    if frame_interval_us:
        opens_us, closes_us = _READOUT_US, _READOUT_US + _EXPOSURE_US
        length_us = closes_us + _READOUT_US
        frames = [
            ApsFrame(t, t + opens_us, t + closes_us, t + length_us, reset, signal)
            for t in range(1000, period_us - length_us, frame_interval_us)
        ]
    readings = []
    if reading_interval_us:
        readings = [
            ImuReading(t, (0.0, -1.0, 0.0), (0.0, 0.0, 0.0), 30.0)
            for t in range(500, period_us, reading_interval_us)
        ]
    return encode_pattern(events, frames, readings, period_us)


def encode_pattern(
    events: Events, frames: Sequence[ApsFrame], readings: Sequence[ImuReading], period_us: int
) -> Pattern:
    """Return the words of a period.

    Args:
        events: Sorted events; those at time 0 are left out, which belongs to the wrap word of the
            period before.
        frames: Frames that end within the period.
        readings: Inertial samples.
        period_us: Length of the period, whole wraps of the camera's 15-bit time [us].
    """
    parts = [frame_blocks(frame, _READOUT) for frame in frames]
    parts += [imu_blocks(reading, _UNIT) for reading in readings]
    near, waiting = Blocks.empty(), Blocks.merge(parts)
    events = events.between(1, period_us)
    encoder = WordEncoder(inverted=True)
    words = []
    for start in range(0, period_us, STEP_US):
        if start % _NEAR_US == 0:
            # A split copies the rest, which is cheap for a few milliseconds.
            near, waiting = waiting.split(start + _NEAR_US)
        until = start + STEP_US
        due, near = near.split(until)
        words.append(encoder.encode(events.between(start, until), due, until).copy())
    ends_at = np.cumsum([len(part) for part in words], dtype=np.int64)
    return Pattern(np.concatenate(words), ends_at, events, len(frames), len(readings))


def _random_events(
    rng: np.random.Generator, events_per_s: float, events_per_row: float, period_us: int
) -> Events:
    wanted = max(int(events_per_s * period_us / 1e6) - 1, 0)
    rows = max(int(wanted / events_per_row), 1)
    sizes = rng.poisson(events_per_row - 1, rows) + 1
    # Time 0 belongs to the wrap word of the period before; the marker comes first.
    starts = np.sort(rng.integers(MARKER_US + 1, period_us, rows))
    x = rng.integers(1, WIDTH, rows)
    t, x = np.repeat(starts, sizes)[:wanted], np.repeat(x, sizes)[:wanted]
    return Events(
        np.concatenate(([MARKER_US], t)).astype(np.int64),
        np.concatenate(([MARKER[0]], x)).astype(np.uint16),
        np.concatenate(([MARKER[1]], rng.integers(0, HEIGHT, len(t)))).astype(np.uint16),
        np.concatenate(([1], rng.integers(0, 2, len(t)))).astype(np.bool_),
    )


class PatternPlayer:
    """Plays a pattern again and again in step with the camera clock.

    Args:
        pattern: The pattern.

    Attributes:
        periods_lost: Stretches that were left out because nobody took them in time.
    """

    def __init__(self, pattern: Pattern) -> None:
        self.periods_lost = 0
        self._pattern = pattern
        self._step = 0

    def due(self, camera_us: int) -> NDArray[np.uint16]:
        """Return the words between the time of the last call and now.

        Args:
            camera_us: Camera clock now [us]; going back restarts the pattern.
        """
        step = camera_us // STEP_US
        if step < self._step:
            self._step = 0
        parts = []
        steps = len(self._pattern.ends)
        while self._step < step:
            at = self._step % steps
            last = min(at + step - self._step, steps)
            start = self._pattern.ends[at - 1] if at else 0
            parts.append(self._pattern.words[start : self._pattern.ends[last - 1]])
            self._step += last - at
        return np.concatenate(parts) if parts else self._pattern.words[:0]

    def refused(self, words: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Return what to send instead of words that found no room: the time they took.

        Args:
            words: What the last call of `due` returned.
        """
        self.periods_lost += 1
        wraps = int(np.sum(words[words >> 12 == _WRAP_WORD >> 12] & _MAX_WRAPS))
        return np.array([_WRAP_WORD | wraps] if wraps else [], np.uint16)


class PatternCamera(VirtualDavis346):
    """Sends a pattern in step with its clock, whatever the host asks of sensor and filters.

    Like the camera it sends what it has after every early packet delay, whoever reads or does not;
    a read returns what was sent since the last one, or waits for what is sent next. Nothing runs
    between two reads.

    Args:
        serial: Serial number, at most eight characters.
        pattern: What to send.
    """

    def __init__(self, serial: str, pattern: Pattern) -> None:
        super().__init__(serial)
        self.player = PatternPlayer(pattern)
        self._sent = 0

    def true_time_us(self) -> int:
        """Return the true time now [us since construction]."""
        return self._clock()

    def _before_read(self, endpoint: int, timeout_s: float | None) -> None:
        if endpoint != endpoints.DATA_ENDPOINT:
            return
        deadline_s = math.inf if timeout_s is None else time.monotonic() + timeout_s
        delay_us = 1e6 * self._early_packet_s()
        while self.streaming:
            sent = int(self._clock() / delay_us)
            if sent != self._sent:
                self._sent = sent
                self._produce(int(sent * delay_us))
            left_s = deadline_s - time.monotonic()
            if len(self._fifo) or left_s <= 0:
                return
            time.sleep(min(max((sent + 1) * delay_us - self._clock(), 0.0) / 1e6, left_s))

    def _produce(self, true_us: int) -> None:
        """Send what the camera has until a true time [us]."""
        with self._condition:
            words = self.player.due(self._oscillator.now(true_us))
            if len(words) and not self._fifo.push(words):
                self._fifo.push(self.player.refused(words))
            # What is sent has waited long enough.
            self._data.flush()
