# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The force that the sensor itself tells in a grasp, calibrated as its owner would.

A grasp begins with the object held, so that the no-contact reference and the gains come from
before: still frames of the same day without contact, and on other days, elsewhere on the gel, a
press with known forces and a mass on a thread, as `calibrate-force --sideways-loads` takes it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from mixtac_cli.calibrate_force.command import LOAD_SD_G
from mixtac_fger.estimator import Estimate, open_estimator
from mixtac_fger.fger_net import CALIBRATED_DEVIATION, with_gain
from mixtac_fger.force_calibration import ForceCalibrationError
from mixtac_fger.pull_calibration import (
    PullCalibration,
    find_pulls,
    fit_pulls,
    last_contact,
    parse_pulls,
)
from mixtac_fger.streaming import ForceEstimator
from mixtac_fger.weights import DEFAULT_MODEL, Model, find_model, read_model
from mixtac_recordings.messages import left_aligned
from mixtac_sim.world.gestures import PULLED_G
from mixtac_sim.world.plans import TrialSpec, simulate

if TYPE_CHECKING:
    from mixtac_events.arrays import Events
    from mixtac_sim.grasp.grasp import Grasp
    from mixtac_sim.pixels.aps import ApsFrame
    from mixtac_sim.world.trial import Trial

FRAME_DELAY_US: Final = 8_000
"""Time from the end of the readout of a frame until the estimator has encoded it [us]."""
ANOTHER_DAY: Final = 1_000_000
"""Added to the seed of a trial for the days of press and pull."""
PRESS_S, PULLS_S = 6.0, 24.0
"""Length of the press, and of the trial with the mass on a thread [s]."""
TOUCHED_N: Final = 0.05
"""True force from which on a window counts for a gain [N]."""


@cache
def _model() -> Model:
    return with_gain(read_model(find_model(DEFAULT_MODEL)), 1.0, CALIBRATED_DEVIATION)


@dataclass(frozen=True, slots=True)
class Gains:
    """Gains of a sensor.

    Attributes:
        normal: Of the normal force, which counts for all axes.
        sideways: Further gain of the sideways force, as known pulls let expect it at other places
            than theirs.
    """

    normal: float = 1.0
    sideways: float = 1.0


@lru_cache(maxsize=16)
def calibrate(device_seed: int, seed: int, preset: str) -> Gains:
    """Return the gains that a press and pulls with known forces give.

    Args:
        device_seed: Seed of the sensor.
        seed: Seed of the trial that is to follow: press and pulls are of other days.
        preset: Difficulty preset of the sensor.
    """
    press, pulls = (
        simulate(TrialSpec(device_seed, seed + days * ANOTHER_DAY, profile, seconds, preset))
        for days, (profile, seconds) in enumerate((('press', PRESS_S), ('pulls', PULLS_S)), 1)
    )
    _, known, found = _beside(press, Gains())
    kept = (known > TOUCHED_N) & np.isfinite(found[:, 2])
    both = float((known[kept] * found[kept, 2]).sum())
    normal = both / float((found[kept, 2] ** 2).sum()) if both > 0.0 else 1.0
    times, _, found = _beside(pulls, Gains(normal))
    try:
        fit = pulled_gain(1e-6 * (times - times[0]), found[:, 2], found[:, :2])
    except ForceCalibrationError:
        return Gains(normal)
    return Gains(normal, fit.elsewhere(1.0)[0])


def pulled_gain(
    t_s: NDArray[np.float64], force: NDArray[np.float64], across: NDArray[np.float64]
) -> PullCalibration:
    """Return the gain of the sideways force by a trial of the profile `pulls`.

    Args:
        t_s: Time of each estimate [s], [T].
        force: Normal force [N], [T].
        across: Sideways force x and y [N], [T, 2].

    Raises:
        ForceCalibrationError: The sensor cannot be calibrated so.
    """
    _, contact = last_contact(t_s, force)
    loads = parse_pulls(f'{PULLED_G:g}', LOAD_SD_G)
    pulls, _ = find_pulls(t_s[contact], across[contact], loads)
    return fit_pulls(pulls)


def _beside(
    trial: Trial, gains: Gains
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Return times [us], true normal force, and estimates of x, y and normal force [n, 3]."""
    force = SensedForce(gains)
    middles = (trial.exposure_start_us + trial.exposure_end_us) // 2
    estimates, done = list[Estimate](), 0
    last_us = int(trial.truth['t_us'][-1])
    cuts = np.searchsorted(trial.events.t, np.arange(0, last_us + 1, 2000))
    for first, after, end_us in zip(cuts, cuts[1:], range(2000, last_us + 1, 2000), strict=False):
        arrived = int(np.searchsorted(trial.arrival_us, end_us))
        for k in range(done, arrived):
            force.estimator.push_frame(left_aligned(trial.frames[k]), int(middles[k]))
        done = max(done, arrived)
        estimates += force.estimator.push_events(trial.events[first:after], end_us)
    times = np.array([each.end_us for each in estimates], np.int64)
    none = (np.nan, np.nan)
    rows = [(*((e.shear.x, e.shear.y) if e.shear else none), e.force) for e in estimates]
    known = np.interp(times, trial.truth['t_us'], trial.truth['fz'])
    return times, known, np.array(rows, np.float64).reshape(-1, 3)


class SensedForce:
    """Follows the stream of a sensor and tells force and shear.

    Args:
        gains: Of the sensor.
        frames: Still frames without contact; by default the first frames of the stream are.

    Attributes:
        estimator: FGER-Net, live, with the shipped model.
    """

    def __init__(self, gains: Gains, frames: Sequence[ApsFrame] = ()) -> None:
        self.estimator = ForceEstimator(
            open_estimator(_model()),
            assume_free=True,
            force_scale=gains.normal,
            sideways_scale=gains.sideways,
        )
        self._frames: list[ApsFrame] = []
        reference = self.estimator.reference
        for frame in frames:
            self._push(frame)
        if frames and reference is not None and reference.array is not None:
            # The contact of the grasp begins without having been seen: a stored reference.
            self.estimator.use_reference(reference.array)

    def advance(self, events: Events, frames: Iterable[ApsFrame], until_us: int) -> list[Estimate]:
        """Return the estimates of the windows that end by a time.

        Args:
            events: Since the last call, true time.
            frames: Whose exposure ended since the last call.
            until_us: No event before this time will follow [us].
        """
        self._frames += frames
        while self._frames and self._frames[0].frame_end_us + FRAME_DELAY_US <= until_us:
            self._push(self._frames.pop(0))
        return self.estimator.push_events(events, until_us)

    def _push(self, frame: ApsFrame) -> None:
        middle = (frame.exposure_start_us + frame.exposure_end_us) // 2
        self.estimator.push_frame(left_aligned(frame.intensity), middle)


def sense_grasp(grasp: Grasp, gains: Gains) -> SensedForce:
    """Return the force of a grasp: its reference is of the time before the contact."""
    reference = open_estimator(_model()).reference
    return SensedForce(gains, grasp.free_frames(0 if reference is None else reference.frames))
