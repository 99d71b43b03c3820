# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The whole tactile sensor: contact, beads, pixels and frames, advanced in true time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixtac_events.arrays import Events
from mixtac_sim import SimulationError
from mixtac_sim.grids import BLOCK_STEPS, BLOCK_US, STEP_US
from mixtac_sim.mechanics.contact import Contact
from mixtac_sim.mechanics.elastomer import Layer, Shear, force_law
from mixtac_sim.pixels.aps import ApsFrame, ApsSettings
from mixtac_sim.pixels.biases import PixelSettings
from mixtac_sim.world.camera import Camera
from mixtac_sim.world.device import Conditions, DeviceModel, draw_conditions, draw_device
from mixtac_sim.world.effects import EASY, Preset
from mixtac_sim.world.profiles import CommandSource

_Contact = tuple[NDArray[np.void], NDArray[np.int64], NDArray[np.float64]]
_Taken = tuple[Events, list[ApsFrame], NDArray[np.void], NDArray[np.int64], NDArray[np.float64]]


TRUTH_DTYPE = np.dtype(
    [('t_us', 'i8'), ('fx', 'f8'), ('fy', 'f8'), ('fz', 'f8'), ('depth_mm', 'f8')]
)
"""Truth at 1 kHz: true time [us], force on the skin [N] (right, down, normal), dent [mm]."""
TRUTH_EVERY = 8
"""Grid steps per row of truth."""


@dataclass(frozen=True, slots=True)
class ContactBlock:
    """Contact over one block; entry k is the state at the end of grid step k.

    Attributes:
        t_us: True time [32] [us].
        wrench: Force [N] and torque about the sensor's centre [Nm] [32, 6].
        depth_mm: Dent [32] [mm].
        elastic_n: Elastic part of the normal force [32] [N].
        shear_mm: Shear displacement [32, 2] [mm].
        indenter: Indenter of each step [32].
        travel_px: Motion of the fastest bead in each step [32] [px].
        longest: The most grid steps that may be taken at once.
    """

    t_us: NDArray[np.int64]
    wrench: NDArray[np.float64]
    depth_mm: NDArray[np.float64]
    elastic_n: NDArray[np.float64]
    shear_mm: NDArray[np.float64]
    indenter: NDArray[np.int8]
    travel_px: NDArray[np.float64]
    longest: int


def truth_rows(
    t_us: NDArray[np.int64], wrench: NDArray[np.float64], depth_mm: NDArray[np.float64]
) -> NDArray[np.void]:
    """Return the rows of truth in some grid steps, ``TRUTH_DTYPE``.

    Args:
        t_us: True time at the end of each step [n] [us].
        wrench: Force [N] and torque [Nm] [n, 6].
        depth_mm: Dent [n] [mm].
    """
    chosen = slice(TRUTH_EVERY - 1, None, TRUTH_EVERY)
    rows = np.zeros(len(t_us[chosen]), TRUTH_DTYPE)
    rows['t_us'], rows['depth_mm'] = t_us[chosen], depth_mm[chosen]
    for axis, name in enumerate(('fx', 'fy', 'fz')):
        rows[name] = wrench[chosen, axis]
    return rows


class Touch:
    """The mechanical side of a trial, block by block.

    Args:
        device: The sensor.
        conditions: Conditions of the trial.
        profile: Commands of what touches it.
        preset: Difficulty of the sensor.
    """

    def __init__(
        self,
        device: DeviceModel,
        conditions: Conditions,
        profile: CommandSource,
        preset: Preset = EASY,
    ) -> None:
        layer = Layer(device.layer.modulus_kpa * conditions.stiffness, device.layer.thickness_mm)
        tools = profile.indenters
        self._profile = profile
        self._laws = [
            force_law(layer, tool, device.mesh_n_per_mm, device.stiffening) for tool in tools
        ]
        self._contact = Contact(self._laws, [tool.mass_g for tool in tools], device.prony)
        slip = preset.contact
        self._shear = Shear(
            layer,
            device.friction * conditions.friction,
            conditions.lean,
            slip.friction_load,
            partial_slip=slip.partial_slip,
        )
        self._place = conditions.contact_mm
        self._last: tuple[float, NDArray[np.float64]] = (0.0, np.zeros(2))
        self._beads = device.beads(layer, conditions.contact_mm, tools, self._laws)

    def block(self, index: int) -> ContactBlock:
        """Return the contact over block ``index``; call it for the blocks in order."""
        first = index * BLOCK_STEPS
        modes, targets, tools = self._profile.commands(first, BLOCK_STEPS)
        path = self._contact.advance(modes, targets, tools)
        radius = np.empty(BLOCK_STEPS)
        for tool in np.unique(tools):
            radius[tools == tool] = self._laws[tool].radius_at(path.elastic_n[tools == tool])
        shear_mm, pull = self._shear.at(path.force_n, path.depth_mm, radius)
        travel = self._travel(tools, path.elastic_n, shear_mm)
        self._last = (float(path.elastic_n[-1]), shear_mm[-1])
        t_us = (np.arange(first, first + BLOCK_STEPS, dtype=np.int64) + 1) * STEP_US
        wrench = self._wrench(pull, path.force_n)
        longest = self._profile.longest_step(first, BLOCK_STEPS)
        return ContactBlock(
            t_us, wrench, path.depth_mm, path.elastic_n, shear_mm, tools, travel, longest
        )

    def rest(self) -> NDArray[np.float64]:
        """Return the images of the beads at rest, as of `BeadMotion.place`."""
        return self._beads.place(0, 0.0, (0.0, 0.0))

    def place(self, block: ContactBlock, k: int) -> NDArray[np.float64]:
        """Return the images of the beads at the end of step `k` of a block."""
        shear = (float(block.shear_mm[k, 0]), float(block.shear_mm[k, 1]))
        return self._beads.place(int(block.indenter[k]), float(block.elastic_n[k]), shear)

    def _travel(
        self,
        tools: NDArray[np.int8],
        elastic_n: NDArray[np.float64],
        shear_mm: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Return the motion of the fastest bead per step [px]."""
        tool = int(tools[-1])
        reach = self._beads.reach_px(tool, np.append(self._last[0], elastic_n))
        slide = np.diff(np.vstack([self._last[1], shear_mm]), axis=0)
        across = self._beads.px_per_mm * np.hypot(slide[:, 0], slide[:, 1])
        return np.asarray(np.abs(np.diff(reach)) + across)

    def _wrench(
        self, pull: NDArray[np.float64], force_n: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return force and torque of a push at the contact point."""
        x, y = (1e-3 * place for place in self._place)
        torque_z = x * pull[:, 1] - y * pull[:, 0]
        columns = (pull[:, 0], pull[:, 1], force_n, y * force_n, -x * force_n, torque_z)
        return np.stack(columns, axis=1)


class Outbox:
    """Output that is ready but may not be due; all times are true time [us]."""

    def __init__(self) -> None:
        self._frames: list[ApsFrame] = []
        self._events: list[Events] = []
        self._truth = [np.empty(0, TRUTH_DTYPE)]
        self._times = [np.empty(0, np.int64)]
        self._wrenches = [np.empty((0, 6))]

    def put(self, events: Events, frames: list[ApsFrame], contact: ContactBlock) -> None:
        """Add events, frames and contact of a block."""
        self._events.append(events)
        self._frames += frames
        self._truth.append(truth_rows(contact.t_us, contact.wrench, contact.depth_mm))
        self._times.append(contact.t_us)
        self._wrenches.append(contact.wrench)

    def take(self, until_us: int) -> _Taken:
        """Return and forget events, frames, truth, wrench times and wrenches before a time."""
        frames = [frame for frame in self._frames if frame.frame_end_us < until_us]
        self._frames = self._frames[len(frames) :]
        return (self._take_events(until_us), frames, *self._take_contact(until_us))

    def _take_events(self, until_us: int) -> Events:
        events = Events.concatenate(self._events)
        split = int(np.searchsorted(events.t, until_us))
        self._events = [events[split:]]
        return events[:split]

    def _take_contact(self, until_us: int) -> _Contact:
        truth, times = np.concatenate(self._truth), np.concatenate(self._times)
        wrenches = np.concatenate(self._wrenches)
        row = int(np.searchsorted(truth['t_us'], until_us))
        split = int(np.searchsorted(times, until_us))
        self._truth, self._times = [truth[row:]], [times[split:]]
        self._wrenches = [wrenches[split:]]
        return truth[:row], times[:split], wrenches[:split]


@dataclass(frozen=True, slots=True, eq=False)
class SensorOutput:
    """Output since the last call; every time is true time [us] since the trial's start.

    Attributes:
        events: Events that left the chip, sorted.
        frames: Frames whose readout ended.
        truth: Force and dent at 1 kHz, ``TRUTH_DTYPE``.
        wrench_us: Times of ``wrench`` [n], int64, at 8 kHz.
        wrench: Force [N] and torque [Nm] on the sensor [n, 6], for the reference sensor.
    """

    events: Events
    frames: list[ApsFrame]
    truth: NDArray[np.void]
    wrench_us: NDArray[np.int64]
    wrench: NDArray[np.float64]


class TactileSensor:
    """A simulated sensor in a trial.

    Output depends on the seeds, profile and settings alone, not on how often it is advanced.

    Args:
        device_seed: Seed of the sensor.
        trial_seed: Seed of the trial.
        profile: Commands of what touches the sensor; after its end nothing does.
        aps: Settings of the frames.
        pixels: Settings of the DVS pixels of a nominal chip.
        preset: Difficulty of the sensor.

    Attributes:
        device: The sensor's constants.
    """

    def __init__(
        self,
        device_seed: int,
        trial_seed: int,
        profile: CommandSource,
        aps: ApsSettings | None = None,
        pixels: PixelSettings | None = None,
        *,
        preset: Preset = EASY,
    ) -> None:
        conditions = draw_conditions(trial_seed, preset)
        self.device: DeviceModel = draw_device(device_seed, preset).on_day(conditions)
        self._touch = Touch(self.device, conditions, profile, preset)
        self._camera = Camera(
            self.device,
            conditions,
            preset,
            trial_seed,
            self._touch.rest(),
            aps=aps,
            pixels=pixels,
        )
        self._block = 0
        self._now_us = 0
        self._outbox = Outbox()

    @property
    def events_lost(self) -> int:
        """Number of events that pixels and readout had to drop so far."""
        return self._camera.lost

    def configure_pixels(self, nominal: PixelSettings) -> None:
        """Change the DVS settings from the next block of 4 ms on, as new biases would."""
        self._camera.configure_pixels(nominal)

    def configure_aps(self, settings: ApsSettings) -> None:
        """Change the frame settings from the next exposure that has not begun."""
        self._camera.configure_aps(settings)

    def advance(self, until_us: int) -> SensorOutput:
        """Return what happened from the last call's time to before ``until_us``.

        Args:
            until_us: True time since the trial's start [us], not before the last call's.

        Raises:
            SimulationError: Time would run backwards.
        """
        if until_us < self._now_us:
            msg = f'cannot advance to {until_us} us: already at {self._now_us} us; ask for later'
            raise SimulationError(msg)
        self._now_us = until_us
        while self._block * BLOCK_US < until_us:
            self._run_block()
        return SensorOutput(*self._outbox.take(until_us))

    def _run_block(self) -> None:
        """Compute the next 4 ms."""
        contact = self._touch.block(self._block)
        events, frames = self._camera.advance(
            contact.elastic_n,
            contact.travel_px,
            contact.longest,
            lambda _, last: self._touch.place(contact, last - 1),
        )
        self._outbox.put(events, frames, contact)
        self._block += 1
