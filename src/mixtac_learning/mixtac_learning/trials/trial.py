# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""One trial as arrays on the camera clock: events, frames, forces, and the windows they share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.errors import MixtacError
from mixtac_sim.world import plans as generation
from mixtac_sim.world.plans import TrialSpec
from mixtac_sim.world.sensor import truth_wrench


class DatasetError(MixtacError):
    """Training data that cannot be read or do not fit the configuration."""


@dataclass(frozen=True, slots=True, eq=False)
class ForceLabel:
    """The force to learn, as a curve.

    Attributes:
        t_us: Camera clock [us], increasing.
        force: Normal force [N], positive when pressed; or across it force x, force y [N] and torque
            z [Nm], [n, 3], with the axes of `mixtac_fger.force_path`.
    """

    t_us: NDArray[np.float64]
    force: NDArray[np.float64]

    def at(self, t_us: NDArray[np.integer]) -> NDArray[np.float32]:
        """Return the force at times on the camera clock."""
        each = np.apply_along_axis(lambda column: np.interp(t_us, self.t_us, column), 0, self.force)
        return np.asarray(each, np.float32)

    def mean(self, start_us: NDArray[np.int64], end_us: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return the mean force from `start_us` to `end_us` (trapezoids on the curve's samples)."""
        steps = np.diff(self.t_us) * 0.5 * (self.force[1:] + self.force[:-1])
        integral = np.concatenate([[0.0], np.cumsum(steps)])
        start, end = (np.interp(t, self.t_us, integral) for t in (start_us, end_us))
        return np.asarray((end - start) / np.maximum(end_us - start_us, 1), np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class TrialArrays:
    """Data of a camera and a force sensor in one trial; camera clock [us].

    Attributes:
        events: Events, sorted.
        frames: Intensities, uint16 [N, height, width].
        exposure_start_us: When each exposure began, int64 [N].
        exposure_end_us: When it ended, int64 [N].
        arrival_us: When the host had the frame, int64 [N].
        truth: True normal force; None if unknown.
        reference: Normal force that the reference sensor measured; None without one.
        across: True force across the normal; None if unknown.
        origin: Where it came from: seeds, profile, file.
        gaps_us: Stretches whose event packets were lost, from and to [us].
    """

    events: Events
    frames: NDArray[np.uint16]
    exposure_start_us: NDArray[np.int64]
    exposure_end_us: NDArray[np.int64]
    arrival_us: NDArray[np.int64]
    truth: ForceLabel | None
    reference: ForceLabel | None
    across: ForceLabel | None = None
    origin: dict[str, Any] = field(default_factory=dict)
    gaps_us: Sequence[tuple[int, int]] = ()

    @property
    def profile(self) -> str:
        """Force profile, `unknown` if a recording does not state it."""
        return str(self.origin.get('profile', 'unknown'))

    def label(self) -> ForceLabel:
        """Return the force to learn: the true one where it is known, else the reference's.

        Raises:
            DatasetError: Neither is known.
        """
        found = self.truth or self.reference
        if found is None:
            name = self.origin.get('name', 'a trial')
            raise DatasetError(f'{name} has no force: record the reference beside the camera')
        return found


def sensor_of(origin: Mapping[str, Any], otherwise: str) -> str:
    """Return which sensor a trial was made with, by where it came from.

    Args:
        origin: `origin` of the source of the trial.
        otherwise: Returned where that is not known.
    """
    return str(origin.get('device_seed', origin.get('sensor', otherwise)))


def window_ends(
    trial: TrialArrays, label: ForceLabel, window_us: int, begin_us: int
) -> NDArray[np.int64]:
    """Return the ends of the windows of a trial, multiples of `window_us`.

    Args:
        trial: Events and frames.
        label: Force; there are no windows outside its time.
        window_us: Length of a window [us].
        begin_us: The first window ends here or later [us, camera clock].

    Raises:
        DatasetError: No window is complete.
    """
    first_us = -(-max(begin_us, int(np.ceil(label.t_us[0]))) // window_us) * window_us
    last_us = int(min(label.t_us[-1], camera_end_us(trial)))
    if last_us < first_us + window_us:
        raise DatasetError(
            'camera and force sensor data do not overlap in time: check the clock fit'
        )
    return np.arange(first_us, last_us + 1, window_us, dtype=np.int64)


def frame_arrivals(
    arrival_us: NDArray[np.int64], ends: NDArray[np.int64], first: int = 0
) -> NDArray[np.int64]:
    """Return, per window, the latest frame from `first` on that arrived in it, -1 for none.

    Args:
        arrival_us: When the host had each frame [us, camera clock].
        ends: Ends of the windows [us].
        first: Frames before this one do not count.
    """
    slots = np.full(len(ends), -1, np.int64)
    windows = np.searchsorted(ends, arrival_us[first:])
    inside = windows < len(ends)
    # Of several frames in a window the last one stays.
    slots[windows[inside]] = np.flatnonzero(inside) + first
    return slots


def camera_start_us(trial: TrialArrays) -> int:
    """Return the first event or exposure of a trial [us, camera clock]."""
    first = int(trial.exposure_start_us[0])
    return min(first, int(trial.events.t[0])) if len(trial.events) else first


def camera_end_us(trial: TrialArrays) -> int:
    """Return until when the camera is known to have run [us, camera clock]."""
    latest = int(trial.events.t[-1]) if len(trial.events) else 0
    return max(latest, int(trial.arrival_us[-1]) if len(trial.arrival_us) else 0)


@dataclass(frozen=True, slots=True)
class SimulatedSource:
    """A trial that the simulator makes when it is asked for.

    Attributes:
        spec: The trial.
    """

    spec: TrialSpec

    @property
    def name(self) -> str:
        """A file name of its seeds, profile and preset."""
        return self.spec.name

    @property
    def origin(self) -> dict[str, Any]:
        """The fields of the specification."""
        return asdict(self.spec) | {'name': self.name, 'simulated': True}

    def content_key(self) -> str:
        """Return the trial's name with the digest of the simulator."""
        return f'{generation.simulator_digest()} {self.name}'

    def load(self) -> TrialArrays:
        """Simulate the trial.

        Raises:
            SimulationError: Unknown profile or preset, or too short a duration.
        """
        trial = generation.simulate(self.spec)
        scale, offset_us = trial.clock
        reference_us = (trial.reference_t_us.astype(np.float64) - offset_us) / scale
        truth_us = trial.truth['t_us'].astype(np.float64)
        return TrialArrays(
            events=trial.events,
            frames=trial.frames,
            exposure_start_us=trial.exposure_start_us,
            exposure_end_us=trial.exposure_end_us,
            arrival_us=trial.arrival_us,
            truth=ForceLabel(truth_us, trial.truth['fz'].astype(np.float64)),
            reference=ForceLabel(reference_us, trial.reference_wrench[:, 2].astype(np.float64)),
            across=ForceLabel(truth_us, truth_wrench(trial.truth)[:, [0, 1, 5]]),
            origin=self.origin,
        )
