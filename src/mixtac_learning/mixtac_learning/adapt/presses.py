# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Recordings of a new sensor cut into presses with known forces.

Each press starts and ends without contact. The force is known from a reference sensor or from
weights placed on the sensor.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mixtac_fger import force_calibration
from mixtac_fger.pull_calibration import PullCalibration, fit_pulls, pull_of, span_at
from mixtac_learning.judge.metrics import CalibrationError
from mixtac_learning.network import FgerNetwork
from mixtac_learning.train.batches import stack
from mixtac_learning.train.stages import estimate
from mixtac_learning.trials.samples import Sample, make_sample
from mixtac_learning.trials.trial import ForceLabel, TrialArrays, camera_end_us, camera_start_us

_NUMBER = r'(\d+(?:\.\d*)?|\.\d+)'
_FORM = re.compile(f'{_NUMBER}:{_NUMBER}-{_NUMBER}')
_US_PER_S = 1e6
MARGIN_S = 0.1
"""Left out at both ends of a load: a hand is not on time [s] (estimate)."""


@dataclass(frozen=True, slots=True)
class Load:
    """A constant force.

    Attributes:
        force: Normal force [N].
        start_s: From here on [s], since the recording began: its first
            event or exposure.
        end_s: Until here [s].
    """

    force: float
    start_s: float
    end_s: float


def parse_load(text: str) -> Load:
    """Return the load of a text like `0.5:3.0-6.0`: newtons, seconds.

    Raises:
        CalibrationError: The text has another form, or the times leave nothing.
    """
    match = _FORM.fullmatch(text.strip())
    if match is None:
        raise CalibrationError(f'load {text!r}: give newtons and seconds like 0.5:3.0-6.0')
    force, start_s, end_s = (float(part) for part in match.groups())
    if end_s - start_s <= 2.0 * MARGIN_S:
        raise CalibrationError(f'load {text!r}: give more than {2 * MARGIN_S:.1f} s')
    return Load(force, start_s, end_s)


REST_S = 0.5
"""Time without the pull before each sideways load [s]."""
PULL_SD_N = 0.01
"""Standard uncertainty of a sideways load [N]: a gram."""


def fit_sideways(
    since_s: NDArray[np.float64], across: NDArray[np.float64], loads: Sequence[Load]
) -> PullCalibration:
    """Return the gain of the sideways force by known pulls: a weight that hangs from the tip.

    What counts is how the estimate differs from that of the `REST_S` before the load, in the same
    contact.

    Args:
        since_s: Times since the start of the recording [s], [T].
        across: Estimates in the first two columns [N], nan where unknown, [T, 2 or more].
        loads: Size of each pull, and when.

    Raises:
        CalibrationError: A load is outside the recording.
        ForceCalibrationError: The estimate hardly sees a pull, or the pulls disagree.
    """
    pulls = []
    for load in loads:
        times = (load.start_s - REST_S - MARGIN_S, load.start_s - MARGIN_S)
        before = span_at(since_s, across, *times)
        inside = span_at(since_s, across, load.start_s + MARGIN_S, load.end_s - MARGIN_S)
        if before is None or inside is None:
            raise CalibrationError(
                f'no sideways force from {load.start_s - REST_S} to {load.end_s} s: correct the'
                ' times, and use a model that gives it'
            )
        known = force_calibration.Load(load.force, PULL_SD_N)
        pulls.append(pull_of(known, None, inside, before, None))
    return fit_pulls(pulls)


def load_label(loads: Sequence[Load], start_us: int, end_us: int) -> ForceLabel:
    """Return a curve through the loads, zero elsewhere; valid in `known_windows` only.

    Args:
        loads: Loads.
        start_us: Beginning of the recording [us, camera clock].
        end_us: Its end [us].

    Raises:
        CalibrationError: Loads overlap, or lie outside the recording.
    """
    ordered = sorted(loads, key=lambda load: load.start_s)
    length_s = (end_us - start_us) / _US_PER_S
    times, forces = [float(start_us)], [0.0]
    before_s = 0.0
    for load in ordered:
        if load.start_s < before_s or load.end_s > length_s:
            raise CalibrationError(
                f'load of {load.force} N from {load.start_s} to {load.end_s} s overlaps another'
                f' one or lies outside the recording of {length_s:.1f} s: correct its times'
            )
        before_s = load.end_s
        start, end = (start_us + _US_PER_S * t for t in (load.start_s, load.end_s))
        times += [start, start + 1.0, end - 1.0, end]
        forces += [0.0, load.force, load.force, 0.0]
    times.append(max(float(end_us), times[-1] + 1.0))
    forces.append(0.0)
    return ForceLabel(np.array(times), np.array(forces))


def known_windows(
    loads: Sequence[Load], window_end_us: NDArray[np.int64], start_us: int
) -> NDArray[np.bool_]:
    """Return in which windows the force is known, bool [T].

    Args:
        loads: Loads.
        window_end_us: Ends of the windows [us, camera clock].
        start_us: Beginning of the recording [us].
    """
    since_s = (window_end_us - start_us) / _US_PER_S
    known = np.zeros(len(since_s), np.bool_)
    for load in loads:
        known |= (since_s > load.start_s + MARGIN_S) & (since_s < load.end_s - MARGIN_S)
    return known


RELEASED_PART = 0.1
"""Estimates below this part of the largest count as no contact."""
RELEASED_N = 0.02
"""Estimates below this always do [N]."""
SHORTEST_RELEASE = 50
"""Windows that a release lasts at least."""
SHORTEST_PRESS = 50
"""Windows that a press lasts at least."""


def cut_presses(sample: Sample, estimate: NDArray[np.floating]) -> list[Sample]:
    """Cut a sample in the middle of each release.

    Args:
        sample: A recording; its force is nan where it is not known.
        estimate: The model's force at the same windows [N], [T]; its scale does not matter.

    Returns:
        One sample per press that has known forces.
    """
    limit = max(RELEASED_N, RELEASED_PART * float(np.abs(estimate).max()))
    pressed = np.abs(estimate) > limit
    borders = [0, *_middles(~pressed), len(pressed)]
    parts = [(a, b) for a, b in pairwise(borders) if b > a]
    return [
        part_of(sample, start, stop)
        for start, stop in parts
        if pressed[start:stop].sum() >= SHORTEST_PRESS
        and np.isfinite(sample.force[start:stop]).any()
    ]


def _middles(released: NDArray[np.bool_]) -> list[int]:
    """Return the middles of the releases between two presses."""
    edges = np.flatnonzero(np.diff(released.astype(np.int8)))
    bounds = [0, *(edges + 1).tolist(), len(released)]
    runs = [(a, b) for a, b in pairwise(bounds) if released[a]]
    return [
        (a + b) // 2 for a, b in runs if b - a >= SHORTEST_RELEASE and a > 0 and b < len(released)
    ]


def part_of(sample: Sample, start: int, stop: int) -> Sample:
    """Return the windows from `start` to before `stop`, with the frames that arrive in them."""
    slots = sample.slots[start:stop]
    used = slots[slots >= 0]
    first, last = (int(used[0]), int(used[-1]) + 1) if len(used) else (0, 1)
    return replace(
        sample,
        window_end_us=sample.window_end_us[start:stop],
        event_features=sample.event_features[start:stop],
        force=sample.force[start:stop],
        across=sample.across[start:stop],
        slots=np.where(slots >= 0, slots - first, -1),
        lags=sample.lags[start:stop],
        frame_inputs=sample.frame_inputs[first:last],
        frame_moments=sample.frame_moments[first:last],
        frame_force=sample.frame_force[first:last],
        frame_across=sample.frame_across[first:last],
    )


def folds(presses: Sequence[Sample], count: int) -> list[list[int]]:
    """Return the presses to hold out together, by index: every `count`-th.

    Raises:
        CalibrationError: There are fewer than two presses.
    """
    if len(presses) < 2:
        raise CalibrationError(
            f'{len(presses)} press: press at least twice and let go in between, as one press'
            ' fits and another one checks'
        )
    number = min(count, len(presses))
    return [list(range(first, len(presses), number)) for first in range(number)]


LONGEST_S = 60.0
"""More is not used [s]: calibrating a sensor is to be a matter of a minute."""


@dataclass(frozen=True, slots=True, eq=False)
class PressSet:
    """The presses that a model is adapted by.

    Attributes:
        presses: Presses, forces are NaN where unknown.
        used_s: Length of the recordings used [s].
        left_out_s: Length beyond the limit [s].
    """

    presses: list[Sample]
    used_s: float
    left_out_s: float


def gather_presses(
    network: FgerNetwork,
    trials: Iterable[TrialArrays],
    loads: Sequence[Load] = (),
    longest_s: float = LONGEST_S,
) -> PressSet:
    """Cut recordings of one sensor into presses.

    Args:
        network: The model to adapt; its estimates show where the sensor is released.
        trials: Recordings, each beginning without contact; with `loads`, one of unknown force.
        loads: Known loads of that recording; empty where the trials know their force.
        longest_s: Later parts are left out [s].

    Raises:
        CalibrationError: There is nothing to use.
        DatasetError: A recording cannot be used.
    """
    config = network.config
    most = round(longest_s * 1e6 / config.window_us)
    presses: list[Sample] = []
    used = left_out = 0
    for trial in trials:
        sample = _sample(network, trial, loads)
        taken = min(len(sample.force), most - used)
        used, left_out = used + taken, left_out + len(sample.force) - taken
        if taken > 0:
            kept = part_of(sample, 0, taken)
            force, _ = estimate(network, stack([replace(kept, force=np.zeros_like(kept.force))]))
            presses += cut_presses(kept, force[:, 0].numpy())
    if not presses:
        raise CalibrationError(
            'the model sees no press with a known force: press the sensor during the recording,'
            ' and let go in between'
        )
    return PressSet(presses, used * config.window_us / 1e6, left_out * config.window_us / 1e6)


def _sample(network: FgerNetwork, trial: TrialArrays, loads: Sequence[Load]) -> Sample:
    if not loads:
        return make_sample(network.config, trial, trial.label(), trial.origin)
    start_us = camera_start_us(trial)
    label = load_label(loads, start_us, camera_end_us(trial))
    sample = make_sample(network.config, trial, label, trial.origin)
    known = known_windows(loads, sample.window_end_us, start_us)
    return replace(sample, force=np.where(known, sample.force, np.float32(np.nan)))
