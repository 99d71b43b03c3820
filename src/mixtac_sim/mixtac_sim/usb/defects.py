# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Defects of the virtual camera that only its data show, and signals that a person would give it.

A defect lasts until `FaultKind.CLEAR`, also while the camera is unplugged. Times are true time.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from mixtac_events.arrays import Events
from mixtac_sim.grids import HEIGHT, WIDTH
from mixtac_sim.pixels.aps import ApsFrame
from mixtac_sim.usb.faults import Fault, FaultKind
from mixtac_sim.usb.words import ImuReading

DEFECTS: Final = frozenset(
    {
        FaultKind.CLOCK_SKEW,
        FaultKind.LOST_WRAP,
        FaultKind.LOST_EDGES,
        FaultKind.STUCK_BIASES,
        FaultKind.MUTE_RETURN,
        FaultKind.NOISE,
        FaultKind.LATE_STAMPS,
        FaultKind.BLUR,
        FaultKind.RIPPLE,
        FaultKind.HEAT,
        FaultKind.FLASH,
        FaultKind.EDGES,
    }
)
"""Kinds of faults that are handled here."""
FLASH_LEVEL: Final = 250.0
"""By how much a flash of the whole exposure brightens a frame [counts of the converter]."""
FLASH_RISE_US: Final = 1000
_MOST_SIGNAL: Final = 1023


class Defects:
    """The defects of one camera. Not thread safe: the device guards it.

    Attributes:
        skew_ppm: Added rate of the clock [1e-6].
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """End all defects and signals."""
        self._active: dict[FaultKind, Fault] = {}
        self._random = np.random.default_rng(0)
        self._flashes: list[tuple[int, int]] = []
        self._due = Events.empty()
        self._edge_us = 0.0
        self._edges = self._wraps = self._wraps_lost = 0
        self.skew_ppm = 0.0

    def begin(self, fault: Fault, now_us: int) -> None:
        """Start a defect or a signal.

        Args:
            fault: One of `DEFECTS`.
            now_us: True time [us].
        """
        if fault.kind is FaultKind.FLASH:
            self._flash(now_us + round(fault.delay * 1e6), round(fault.seconds * 1e6))
            return
        self._active[fault.kind] = fault
        self._random = np.random.default_rng(fault.seed)
        if fault.kind is FaultKind.CLOCK_SKEW:
            self.skew_ppm = fault.amount
        elif fault.kind is FaultKind.EDGES:
            self._edge_us = float(now_us)

    @property
    def stuck_biases(self) -> bool:
        """Whether the chip takes no new biases."""
        return FaultKind.STUCK_BIASES in self._active

    @property
    def mute_return(self) -> bool:
        """Whether the camera sends no data after it was plugged in."""
        return FaultKind.MUTE_RETURN in self._active

    def _flash(self, start_us: int, length_us: int) -> None:
        self._flashes = [*self._flashes[-20:], (start_us, start_us + length_us)]
        parts = [self._due]
        for t, on in ((start_us, True), (start_us + length_us, False)):
            times = np.sort(self._random.integers(t, t + FLASH_RISE_US, HEIGHT * WIDTH))
            pixels = self._random.permutation(HEIGHT * WIDTH)
            x, y = (pixels % WIDTH).astype(np.uint16), (pixels // WIDTH).astype(np.uint16)
            parts.append(Events(times.astype(np.int64), x, y, np.full(len(times), on)))
        self._due = _sorted(Events.concatenate(parts))

    def events(self, events: Events, until_us: int) -> Events:
        """Return what the defective camera sees instead of these events.

        Args:
            events: Events [us, true time] before `until_us`.
            until_us: Time up to which they are complete [us].
        """
        noise, ripple = (self._active.get(k) for k in (FaultKind.NOISE, FaultKind.RIPPLE))
        if noise is not None and len(events):
            picked = np.repeat(np.arange(len(events)), 1 + round(noise.amount))
            x = self._random.integers(0, WIDTH, len(picked)).astype(np.uint16)
            y = self._random.integers(0, HEIGHT, len(picked)).astype(np.uint16)
            events = Events(events.t[picked], x, y, events.polarity[picked])
        if ripple is not None and len(events):
            light = 0.5 + 0.5 * np.cos(2e-6 * np.pi * ripple.amount * events.t)
            events = events[self._random.random(len(events)) < light]
        due = int(np.searchsorted(self._due.t, until_us))
        if due:
            events = _sorted(Events.concatenate([events, self._due[:due]]))
            self._due = self._due[due:]
        return events

    def frame(self, frame: ApsFrame) -> ApsFrame:
        """Return what the defective camera makes of a frame."""
        late, blur = (self._active.get(k) for k in (FaultKind.LATE_STAMPS, FaultKind.BLUR))
        opened, closed = frame.exposure_start_us, frame.exposure_end_us
        lit_us = sum(max(min(closed, b) - max(opened, a), 0) for a, b in self._flashes)
        if not (late or blur or lit_us):
            return frame
        seen = frame.reset.astype(np.float32) - frame.signal
        if blur is not None:
            seen = gaussian_filter(seen, blur.amount)
        seen = seen + np.float32(FLASH_LEVEL * lit_us / max(closed - opened, 1))
        signal = np.clip(np.round(frame.reset - seen), 0, _MOST_SIGNAL).astype(np.uint16)
        late_us = round(late.delay * 1e6) if late is not None else 0
        return ApsFrame(
            frame.frame_start_us,
            opened + late_us,
            closed + late_us,
            frame.frame_end_us + late_us,
            frame.reset,
            signal,
        )

    def reading(self, reading: ImuReading) -> ImuReading:
        """Return what the defective camera makes of an inertial sample."""
        heat = self._active.get(FaultKind.HEAT)
        if heat is None:
            return reading
        return replace(reading, temperature_c=reading.temperature_c + heat.amount)

    def edges(self, until_us: int) -> list[int]:
        """Return the rising edges of the signal at the connector before a time [us]."""
        signal, lost = (self._active.get(k) for k in (FaultKind.EDGES, FaultKind.LOST_EDGES))
        found: list[int] = []
        if signal is None or signal.amount <= 0:
            return found
        while self._edge_us < until_us:
            self._edges += 1
            if lost is None or self._edges % max(lost.size, 1):
                found.append(int(self._edge_us))
            self._edge_us += 1e6 / signal.amount
        return found

    def words(self, words: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Return what the defective camera sends instead of these words."""
        lost = self._active.get(FaultKind.LOST_WRAP)
        if lost is None:
            return words
        wraps = np.flatnonzero(words >> 12 == 7)
        numbers = self._wraps + 1 + np.arange(len(wraps))
        self._wraps += len(wraps)
        gone = wraps[numbers % max(lost.size, 1) == 0][: max(lost.count - self._wraps_lost, 0)]
        self._wraps_lost += len(gone)
        return np.delete(words, gone)


def _sorted(events: Events) -> Events:
    order = np.argsort(events.t, kind='stable')
    return Events(events.t[order], events.x[order], events.y[order], events.polarity[order])
