# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A grasp in real time, and an optional clock that waits for slip control and arm.

A loop through other processes must not act on old data. On a slow host, simulated time therefore
runs slower, and nodes that use `/clock` respond to an event as early in simulated time as on a fast
host.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from mixtac_sim.grasp.grasp import Grasp
from mixtac_sim.grasp.objects import GraspSetup
from mixtac_sim.grids import BLOCK_STEPS, BLOCK_US
from mixtac_sim.live.virtual_sensor import SimulationClock
from mixtac_sim.pixels.aps import ApsSettings
from mixtac_sim.pixels.biases import PixelSettings
from mixtac_sim.world.effects import Preset
from mixtac_sim.world.sensor import NOTHING, SensorOutput, truth_rows

RESTART_US = 500_000
"""Step of the stamps against simulated time that counts as a new origin [us]."""


class AnswerPace:
    """Limits simulated time by answers that are stamped with it.

    Stamps count simulated time, without a drift, from an origin that is not known here. No answer
    comes before what it answers, so the largest difference of stamp and simulated time seen so far
    is nearest to that origin; it is too small by the smallest delay of an answer.

    Args:
        ahead_us: Largest lead of simulated time over the last answer [us].
        patience_s: Host time without an answer after which time runs freely [s]: longer than a
            process waits for its turn on a busy host, or than it takes to enable slip control.
        monotonic: The host's monotonic clock [s].
    """

    def __init__(
        self,
        ahead_us: int,
        patience_s: float = 3.0,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._ahead_us = ahead_us
        self._patience_s = patience_s
        self._monotonic = monotonic
        self._origin_us: int | None = None
        self._answered_us = 0
        self._heard_s = -math.inf

    def answer(self, stamp_us: int, now_us: int) -> None:
        """Register an answer.

        Args:
            stamp_us: End of the answered window [us], simulated time from any origin.
            now_us: Simulated time [us].
        """
        origin_us = stamp_us - now_us
        if self._origin_us is None or abs(origin_us - self._origin_us) > RESTART_US:
            self._origin_us = origin_us
        self._origin_us = max(self._origin_us, origin_us)
        self._answered_us = stamp_us - self._origin_us
        self._heard_s = self._monotonic()

    def limit_us(self) -> int | None:
        """Return the latest simulated time allowed [us], None without answers."""
        if self._monotonic() - self._heard_s > self._patience_s:
            return None
        return self._answered_us + self._ahead_us


class PacedClock(SimulationClock):
    """Simulated time [us] that never passes what is simulated; safe to ask from any thread.

    Args:
        paces: Further limits.
        host: Clocks of the host, as of `SimulationClock`.
    """

    def __init__(self, paces: Sequence[AnswerPace] = (), *host: Callable[[], int]) -> None:
        super().__init__(*host)
        self._lock = Lock()
        self._paces = tuple(paces)
        self._reached_us = self._last_us = 0

    def reached(self, until_us: int) -> None:
        """Report that the simulation has reached a time [us]."""
        with self._lock:
            self._reached_us = max(self._reached_us, until_us)

    def now_us(self) -> int:
        """Return the present simulated time [us]; time that the host is late counts as lost."""
        with self._lock:
            now_us = super().now_us()
            limits = [each.limit_us() for each in self._paces]
            limit_us = min([self._reached_us, *(each for each in limits if each is not None)])
            # Late answers stop time; they never set it back.
            late_us = now_us - max(limit_us, self._last_us)
            if late_us > 0:
                self.lost_us += late_us
                now_us -= late_us
            self._last_us = now_us
            return now_us

    def lose(self, lost_us: int) -> None:
        """Delay simulated time by ``lost_us`` [us]."""
        with self._lock:
            super().lose(lost_us)

    def to_epoch_ns(self, t_us: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert simulated times [us, int64] to ns since the start in host time [int64]."""
        return np.asarray(self.start_epoch_ns + t_us * 1000, np.int64)


LOST_MM = 50.0
"""Fall after which the object is put back [mm]."""
GRIP_BLOCKS = 150
"""Blocks in which a hand holds the object and the grasp comes back to its force: 0.6 s."""
RAMP_BLOCKS = 75
"""Blocks of these in which the force changes: 0.3 s."""
MOST_REACHED = 2048
"""Postures that wait to be taken, one per block: 8 s."""


class LiveGrasp:
    """A grasp that is advanced in blocks of 4 ms, with the fingertip moved from outside.

    Args:
        setup: Object and force; its impact is left out, ``strike`` makes one.
        device_seed: Seed of the sensor.
        seed: Seed of the trial.
        preset: Difficulty of the sensor.
        clock: Clock that waits for the simulation.
        open_first: The fingertip touches nothing until the first ``put_back``.

    Attributes:
        grasp_n: Force of the grasp at the start [N].
        object_mm: How far the object is below where it was held [mm].
    """

    def __init__(
        self,
        setup: GraspSetup,
        device_seed: int,
        seed: int,
        preset: Preset,
        clock: PacedClock,
        *,
        open_first: bool = False,
    ) -> None:
        self._grasp = Grasp(replace(setup, knock_mm_s=0.0), device_seed, seed, preset)
        self.grasp_n = self._grasp.grasp_n
        self._clock = clock
        self._lock = Lock()
        self._wanted_mm = self._place_mm = 0.0
        self._posture: tuple[float, ...] = ()
        self._reached: deque[tuple[int, tuple[float, ...]]] = deque(maxlen=MOST_REACHED)
        self._strike_mm_s = 0.0
        self._back, self._open = False, open_first
        self._gripping, self._from_n = 0, self.grasp_n
        self._block = 0
        self._late = NOTHING
        self.object_mm = 0.0

    def move(self, advance_mm: float, posture: tuple[float, ...] = ()) -> None:
        """Move the fingertip along the normal, to a place counted from where the grasp began [mm].

        Args:
            advance_mm: The place [mm].
            posture: Joint positions of the arm there, for `take_reached`.
        """
        with self._lock:
            self._wanted_mm, self._posture = advance_mm, posture

    def take_reached(self, until_us: int) -> list[tuple[int, tuple[float, ...]]]:
        """Return the postures reached up to a time since the last call, and when [us]."""
        with self._lock:
            ready = sum(reached_us <= until_us for reached_us, _ in self._reached)
            return [self._reached.popleft() for _ in range(ready)]

    def strike(self, speed_mm_s: float) -> None:
        """Strike the object in the next block, which gives it a speed [mm/s]."""
        with self._lock:
            self._strike_mm_s = speed_mm_s

    def put_back(self) -> None:
        """Put the object back from the next block on, held by hand until it is gripped anew."""
        with self._lock:
            self._back = True

    def configure_aps(self, settings: ApsSettings) -> None:
        """Change the settings of the next frames."""
        if self._grasp.camera is not None:
            self._grasp.camera.configure_aps(settings)

    def configure_pixels(self, nominal: PixelSettings) -> None:
        """Change the event pixels, as new biases would."""
        if self._grasp.camera is not None:
            self._grasp.camera.configure_pixels(nominal)

    def advance(self, until_us: int) -> SensorOutput:
        """Return what happens until a time, in whole blocks of 4 ms [us]."""
        parts = [self._late]
        while (self._block + 1) * BLOCK_US <= until_us:
            parts.append(self._advance_block())
            self._block += 1
        # The last step ends at that very time.
        due, self._late = SensorOutput.join(parts).split(until_us + 1)
        self._clock.reached(until_us)
        return due

    def _advance_block(self) -> SensorOutput:
        with self._lock:
            wanted, strike, back = self._wanted_mm, self._strike_mm_s, self._back
            self._strike_mm_s, self._back = 0.0, False
            if self._posture:
                self._reached.append(((self._block + 1) * BLOCK_US, self._posture))
        if back or self.object_mm > LOST_MM:
            self._gripping, self._open = GRIP_BLOCKS, False
        if strike > 0.0:
            self._grasp.strike(strike)
        way = np.linspace(self._place_mm, wanted, BLOCK_STEPS + 1)[1:]
        self._place_mm = wanted
        if self._open:
            block = self._grasp.grip_anew(np.zeros(BLOCK_STEPS), wanted)
            self._from_n = 0.0
        elif self._gripping > 0:
            self._gripping -= 1
            left = max(self._gripping - (GRIP_BLOCKS - RAMP_BLOCKS), 0) / RAMP_BLOCKS
            force = self.grasp_n + left * (self._from_n - self.grasp_n)
            block = self._grasp.grip_anew(np.full(BLOCK_STEPS, force), wanted)
        else:
            block = self._grasp.advance(way)
            self._from_n = float(block.normal_n[-1])
        self.object_mm = float(block.object_mm[-1])
        # The object drags the skin down.
        wrench = np.zeros((BLOCK_STEPS, 6))
        wrench[:, 1], wrench[:, 2] = block.pull_n, block.normal_n
        truth = truth_rows(block.t_us, wrench, np.full(BLOCK_STEPS, np.nan))
        return SensorOutput(block.events, block.frames, truth, block.t_us, wrench)
