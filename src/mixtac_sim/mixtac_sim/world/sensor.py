# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The whole tactile sensor: contact, beads, pixels and frames, advanced in true time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events, Floats
from mixtac_sim.grids import BLOCK_STEPS, BLOCK_US, STEP_US
from mixtac_sim.mechanics.contact import Contact
from mixtac_sim.mechanics.elastomer import Shear
from mixtac_sim.mechanics.sliding import Across, Sliding
from mixtac_sim.optics.beads import SlidingBeads
from mixtac_sim.pixels.aps import ApsFrame
from mixtac_sim.world.camera import Camera
from mixtac_sim.world.device import DeviceModel, draw_conditions, draw_device, draw_flicker
from mixtac_sim.world.effects import EASY, Preset
from mixtac_sim.world.segments import LiveProfile, Profile

TRUTH_DTYPE = np.dtype(
    [('t_us', 'i8'), ('fx', 'f8'), ('fy', 'f8'), ('fz', 'f8'), ('depth_mm', 'f8'), ('tz', 'f8')]
)
"""Truth at 1 kHz: true time [us], force on the skin [N] (right, down, normal), dent [mm], torque
about the normal through the contact [Nm]."""
TRUTH_EVERY = 8
"""Grid steps per row of truth."""


def truth_rows(
    t_us: NDArray[np.int64], wrench: Floats, depth_mm: Floats, torque_nm: Floats | None = None
) -> NDArray[np.void]:
    """Return the rows of truth in some grid steps, ``TRUTH_DTYPE``.

    Args:
        t_us: True time at the end of each step [n] [us].
        wrench: Force [N] and torque [Nm] [n, 6].
        depth_mm: Dent [n] [mm].
        torque_nm: Torque about the normal through the contact [n] [Nm]; None for none.
    """
    chosen = slice(TRUTH_EVERY - 1, None, TRUTH_EVERY)
    rows = np.zeros(len(t_us[chosen]), TRUTH_DTYPE)
    rows['t_us'], rows['depth_mm'] = t_us[chosen], depth_mm[chosen]
    for axis, name in enumerate(('fx', 'fy', 'fz')):
        rows[name] = wrench[chosen, axis]
    if torque_nm is not None:
        rows['tz'] = torque_nm[chosen]
    return rows


def truth_wrench(truth: NDArray[np.void]) -> Floats:
    """Return the wrench of rows of truth at the contact [n, 6]; its tilting torques are zero.

    In the contact frame: x to the right and y upwards in the image, z into the gel.
    """
    none = np.zeros(len(truth))
    return np.stack([truth['fx'], -truth['fy'], truth['fz'], none, none, -truth['tz']], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class SensorOutput:
    """Output over some time; every time is true time [us] since the trial's start.

    Attributes:
        events: Events that left the chip, sorted.
        frames: Frames whose readout ended.
        truth: Force, dent and torque at 1 kHz, ``TRUTH_DTYPE``.
        wrench_us: Times of ``wrench`` [n], int64, at 8 kHz.
        wrench: Force [N] and torque [Nm] on the sensor [n, 6], for the reference sensor.
    """

    events: Events
    frames: list[ApsFrame]
    truth: NDArray[np.void]
    wrench_us: NDArray[np.int64]
    wrench: Floats

    @staticmethod
    def join(parts: list[SensorOutput]) -> SensorOutput:
        """Return parts that follow each other as one; at least one part."""
        return SensorOutput(
            Events.concatenate([part.events for part in parts]),
            [frame for part in parts for frame in part.frames],
            np.concatenate([part.truth for part in parts]),
            np.concatenate([part.wrench_us for part in parts]),
            np.concatenate([part.wrench for part in parts]),
        )

    def split(self, until_us: int) -> tuple[SensorOutput, SensorOutput]:
        """Return what comes before a time [us], and the rest."""
        events, frames, truth = self.events, self.frames, self.truth
        t_us, wrench = self.wrench_us, self.wrench
        i = int(np.searchsorted(events.t, until_us))
        j = sum(frame.frame_end_us < until_us for frame in frames)
        k = int(np.searchsorted(truth['t_us'], until_us))
        n = int(np.searchsorted(t_us, until_us))
        return (
            SensorOutput(events[:i], frames[:j], truth[:k], t_us[:n], wrench[:n]),
            SensorOutput(events[i:], frames[j:], truth[k:], t_us[n:], wrench[n:]),
        )


NOTHING = SensorOutput(
    Events.empty(), [], np.empty(0, TRUTH_DTYPE), np.empty(0, np.int64), np.empty((0, 6))
)
"""Output of no time."""


class TactileSensor:
    """A simulated sensor in a trial.

    Output depends on the seeds, profile and settings alone, not on how often it is advanced.

    Args:
        device_seed: Seed of the sensor.
        trial_seed: Seed of the trial.
        profile: Commands of what touches the sensor; after its end nothing does.
        preset: Difficulty of the sensor.
        session: Seed of the day, which trials of one session share: mount, lamp, contact point,
            temperature of the gel; None for a day of its own.

    Attributes:
        device: The sensor on the day of the trial.
        contact_mm: First contact point, right and down from the optical axis [mm].
        configure_aps: Changes when frames are taken, from the next exposure that has not begun.
        configure_pixels: Changes the DVS settings from the next block of 4 ms on, as new biases
            would.
    """

    def __init__(
        self,
        device_seed: int,
        trial_seed: int,
        profile: Profile | LiveProfile,
        *,
        preset: Preset = EASY,
        session: int | None = None,
    ) -> None:
        day = trial_seed if session is None else session
        conditions, slip = draw_conditions(day, preset), preset.contact
        device = draw_device(device_seed, preset).on_day(conditions)
        tools = profile.indenters
        self.device: DeviceModel = device
        self._profile = profile
        self._laws = [device.law(tool) for tool in tools]
        self._contact = Contact(self._laws, [tool.mass_g for tool in tools], device.prony)
        self._shear = Shear(
            device.layer,
            device.friction,
            conditions.lean,
            slip.friction_load,
            partial_slip=slip.partial_slip,
        )
        self.contact_mm, self._conditions = conditions.contact_mm, conditions
        self._last: tuple[float, Floats] = (0.0, np.zeros(2))
        self._last_slid = np.zeros(3)
        self._beads = device.beads(conditions.contact_mm, tools)
        self._sliding = Sliding(self._shear, device.prony)
        self._sliding_beads = SlidingBeads(
            lambda k, place: device.beads(place, tools[k : k + 1]), conditions.contact_mm
        )
        # What falls by its own weight falls on one place.
        self._second = 0.0 if any(tool.mass_g for tool in tools) else conditions.second
        x, y = np.add(conditions.contact_mm, conditions.second_mm).tolist()
        self._other = device.beads((x, y), tools) if self._second else None
        rest = self._beads.place(0, 0.0, (0.0, 0.0))
        self._rest = rest.copy()
        flicker = draw_flicker(day, preset.light)
        self._camera = Camera(device, conditions, preset, trial_seed, rest, flicker)
        self.configure_aps = self._camera.configure_aps
        self.configure_pixels = self._camera.configure_pixels
        self._block = 0
        self._late = NOTHING

    def advance(self, until_us: int) -> SensorOutput:
        """Return what happened from the last call's time to before ``until_us``.

        Args:
            until_us: True time since the trial's start [us], not before the last call's.
        """
        parts = [self._late]
        while self._block * BLOCK_US < until_us:
            parts.append(self._run_block())
        due, self._late = SensorOutput.join(parts).split(until_us)
        return due

    def _run_block(self) -> SensorOutput:
        """Return the next 4 ms: contact, and what the camera sees of it."""
        first = self._block * BLOCK_STEPS
        modes, targets, tools = self._profile.commands(first, BLOCK_STEPS)
        path = self._contact.advance(modes, targets, tools)
        radius = np.empty(BLOCK_STEPS)
        for tool in np.unique(tools):
            radius[tools == tool] = self._laws[tool].radius_at(path.elastic_n[tools == tool])
        moves = self._profile.motion(first, BLOCK_STEPS)
        across = None if moves is None else self._sliding.advance(moves, path, radius)
        if across is None:
            shear_mm, pull = self._shear.at(path.force_n, path.depth_mm, radius)
        else:
            shear_mm, pull = across.shear_mm, across.pull_n

        def place(_: int, last: int) -> Floats:
            right, down = shear_mm[last - 1].tolist()
            tool, elastic_n = int(tools[last - 1]), float(path.elastic_n[last - 1])
            if across is None:
                spots = self._beads.place(tool, elastic_n, (right, down))
            else:
                x, y = across.place_mm[last - 1].tolist()
                turn = float(across.turn_rad[last - 1])
                spots = self._sliding_beads.place(tool, elastic_n, (right, down), turn, (x, y))
            if self._other is not None:
                spots += self._other.place(tool, self._second * elastic_n, (0.0, 0.0)) - self._rest
            grown = self._conditions.growth_at((first + last) * STEP_US)
            spots[:, :2] += grown * (spots[:, :2] - self.device.lens.centre_px)
            return spots

        travel = self._travel(tools, path.elastic_n, shear_mm)
        if across is not None:
            travel += self._slid_px(across, int(tools[-1]), path.elastic_n, radius)
        longest = self._profile.longest_step(first, BLOCK_STEPS)
        events, frames = self._camera.advance(path.elastic_n, travel, longest, place)
        t_us = (np.arange(first, first + BLOCK_STEPS, dtype=np.int64) + 1) * STEP_US
        self._last = (float(path.elastic_n[-1]), shear_mm[-1])
        self._block += 1
        wrench = self._wrench(pull, (1.0 + self._second) * path.force_n, across)
        torque_nm = None if across is None else across.torque_nm
        truth = truth_rows(t_us, wrench, path.depth_mm, torque_nm)
        return SensorOutput(events, frames, truth, t_us, wrench)

    def _travel(self, tools: NDArray[np.int8], elastic_n: Floats, shear_mm: Floats) -> Floats:
        """Return the motion of the fastest bead per step [px]."""
        tool = int(tools[-1])
        reach = self._beads.reach_px(tool, np.append(self._last[0], elastic_n))
        slide = np.diff(np.vstack([self._last[1], shear_mm]), axis=0)
        across = self._beads.px_per_mm * np.hypot(slide[:, 0], slide[:, 1])
        return np.asarray(np.abs(np.diff(reach)) + across)

    def _slid_px(self, across: Across, tool: int, elastic_n: Floats, radius_mm: Floats) -> Floats:
        """Return the motion per step of the fastest bead by turn and slide [px]."""
        slid = np.column_stack([across.place_mm, across.turn_rad])
        steps = np.abs(np.diff(np.vstack([self._last_slid, slid]), axis=0))
        self._last_slid = slid[-1]
        # A dent moves beads by its slope, which is that of a cone as wide as the contact.
        slope = self._beads.reach_px(tool, elastic_n) / np.maximum(radius_mm, 1.0)
        turned = self._beads.px_per_mm * np.maximum(radius_mm, 2.5) * steps[:, 2]
        return np.asarray(slope * np.hypot(steps[:, 0], steps[:, 1]) + turned)

    def _wrench(self, pull: Floats, force_n: Floats, across: Across | None) -> Floats:
        """Return force [N] and torque about the sensor's centre [Nm] of a push at the contact."""
        place, torque_nm = np.zeros(2), np.zeros(1)
        if across is not None:
            place, torque_nm = across.place_mm + across.shear_mm, across.torque_nm
        x, y = (1e-3 * (here + slid) for here, slid in zip(self.contact_mm, place.T, strict=True))
        torque_z = x * pull[:, 1] - y * pull[:, 0] + torque_nm
        columns = (pull[:, 0], pull[:, 1], force_n, y * force_n, -x * force_n, torque_z)
        return np.stack(columns, axis=1)
