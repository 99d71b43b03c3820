# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A grasp in real time: what the virtual sensor runs instead of indenters."""

from __future__ import annotations

from threading import Lock
from typing import TYPE_CHECKING

import numpy as np

from mixtac_events.arrays import Events
from mixtac_sim.grasp.grasp import Grasp
from mixtac_sim.sensor import SensorOutput
from mixtac_sim.steps import BLOCK_STEPS, BLOCK_US
from mixtac_sim.touch import TRUTH_DTYPE, TRUTH_EVERY

if TYPE_CHECKING:
    from mixtac_sim.aps import ApsFrame, ApsSettings
    from mixtac_sim.grasp.grasp import GraspBlock
    from mixtac_sim.grasp.objects import GraspSetup
    from mixtac_sim.pixels import PixelSettings
    from mixtac_sim.presets import Preset


LOST_MM = 50.0
"""An object that has fallen farther is put back at once [mm]."""


class LiveGrasp:
    """A grasp that is advanced in blocks of 4 ms and told from outside where the fingertip is.

    Args:
        setup: Object and force; its blow is left out, ``strike`` makes one.
        device_seed: The sensor.
        seed: The day.
        preset: How hard the sensor is.
    """

    def __init__(self, setup: GraspSetup, device_seed: int, seed: int, preset: Preset) -> None:
        self._grasp = Grasp(setup.knocked(0.0), device_seed, seed, preset)
        self._lock = Lock()
        self._wanted_mm = self._place_mm = 0.0
        self._strike_mm_s = 0.0
        self._back = False
        self._block = 0
        self._frames: list[ApsFrame] = []
        self._object_mm = 0.0

    @property
    def grasp_n(self) -> float:
        """Return the force of the grasp at the start [N]."""
        return self._grasp.grasp_n

    @property
    def object_mm(self) -> float:
        """Return how far the object is below where it was held [mm]."""
        return self._object_mm

    def move(self, advance_mm: float) -> None:
        """Tell where the fingertip is along the normal from where the grasp began [mm]."""
        with self._lock:
            self._wanted_mm = advance_mm

    def strike(self, speed_mm_s: float) -> None:
        """Let a blow come with the next block that gives the object a speed [mm/s]."""
        with self._lock:
            self._strike_mm_s = speed_mm_s

    def put_back(self) -> None:
        """Put the object back with the next block."""
        with self._lock:
            self._back = True

    def configure_aps(self, settings: ApsSettings) -> None:
        """Change the frames to come."""
        if self._grasp.camera is not None:
            self._grasp.camera.configure_aps(settings)

    def configure_pixels(self, nominal: PixelSettings) -> None:
        """Change the event pixels, as new biases would."""
        if self._grasp.camera is not None:
            self._grasp.camera.configure_pixels(nominal)

    def advance(self, until_us: int) -> SensorOutput:
        """Return what happens until a time, in whole blocks of 4 ms [us]."""
        blocks = []
        while (self._block + 1) * BLOCK_US <= until_us:
            blocks.append(self._advance_block())
            self._block += 1
        events = Events.concatenate([b.events for b in blocks if b.events is not None])
        ready = [frame for frame in self._frames if frame.frame_end_us < until_us]
        self._frames = self._frames[len(ready) :]
        times = [b.t_us for b in blocks] or [np.empty(0, np.int64)]
        wrenches = [_wrench(b) for b in blocks] or [np.empty((0, 6))]
        t_us, wrench = np.concatenate(times), np.concatenate(wrenches)
        truth = np.zeros(len(t_us) // TRUTH_EVERY, TRUTH_DTYPE)
        chosen = slice(TRUTH_EVERY - 1, None, TRUTH_EVERY)
        truth['t_us'], truth['depth_mm'] = t_us[chosen], np.nan
        truth['fy'], truth['fz'] = wrench[chosen, 1], wrench[chosen, 2]
        return SensorOutput(events, ready, truth, t_us, wrench)

    def _advance_block(self) -> GraspBlock:
        with self._lock:
            wanted, strike, back = self._wanted_mm, self._strike_mm_s, self._back
            self._strike_mm_s, self._back = 0.0, False
        if back or self._object_mm > LOST_MM:
            self._grasp.put_back()
        if strike > 0.0:
            self._grasp.strike(strike)
        way = np.linspace(self._place_mm, wanted, BLOCK_STEPS + 1)[1:]
        self._place_mm = wanted
        block = self._grasp.advance(way)
        self._frames += block.frames
        self._object_mm = float(block.object_mm[-1])
        return block


def _wrench(block: GraspBlock) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return force [N] and torque [N m] on the skin [n, 6]: the object drags it down."""
    wrench = np.zeros((len(block.t_us), 6))
    wrench[:, 1], wrench[:, 2] = block.pull_n, block.normal_n
    return wrench
