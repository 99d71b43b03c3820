# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Choosing how far a model is adapted: as it is, one gain, or its last layers as well.

Each way is fitted to all presses but some and judged on those, in turn; the least error wins, and
the more it changes, the more it has to win by. What won is then fitted to all presses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from mixtac_fger.adapt.gain import with_gain
from mixtac_fger.adapt.last_layers import tuned
from mixtac_fger.adapt.presses import folds
from mixtac_fger.batches import stack
from mixtac_fger.calibration import SMALLEST_FORCE_N, fit_scale
from mixtac_fger.errors import CalibrationError
from mixtac_fger.train.deviation_stage import calibrate_deviation, collect, joined
from mixtac_fger.train.sequence_groups import MemoryGroups
from mixtac_fger.training import estimate

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from mixtac_fger.batches import Sequences
    from mixtac_fger.dataset import Sample
    from mixtac_fger.network import FgerNetwork
    from mixtac_fger.train.deviation_stage import Errors

    Say = Callable[[str], None]

WAYS = ('unchanged', 'gain', 'last_layers')
"""From the least change to the largest."""
FOLDS = 3
LEAST_WIN = 0.97
"""A larger change must bring the held-out error below this part of the smaller one's."""
LEAST_WIN_N = 1e-3
"""And by this much [N]."""
SHORTEST_PRESSED_S = 2.0
"""Known forces above `SMALLEST_FORCE_N` that are needed [s]."""
GAINS = (0.2, 5.0)
"""Limits of a gain that a gel can explain (estimate)."""
LEAST_CORRELATION = 0.7
"""Of estimate and known force: below it they do not belong together (estimate)."""


@dataclass(frozen=True, slots=True, eq=False)
class Adapted:
    """A model for a new sensor.

    Attributes:
        network: In evaluation mode.
        way: One of `WAYS`.
        gain: Fitted to all presses; 1 for `unchanged`.
        held_out_mae: Error on held-out presses, per way [N].
        presses: Number of presses.
        pressed_s: Known forces above `SMALLEST_FORCE_N` [s].
    """

    network: FgerNetwork
    way: str
    gain: float
    held_out_mae: dict[str, float]
    presses: int
    pressed_s: float


def adapt(
    network: FgerNetwork, presses: Sequence[Sample], say: Say = lambda _text: None
) -> Adapted:
    """Adapt a network to the sensor that made the presses.

    Args:
        network: Not changed.
        presses: At least two; forces are nan where they are not known.
        say: Called with what is done now.

    Raises:
        CalibrationError: The presses are too few, too short, too weak, or do not belong to what
            the model sees.
    """
    groups = folds(presses, FOLDS)
    pressed_s = _check(network, presses)
    errors: dict[str, list[Errors]] = {way: [] for way in WAYS}
    for number, held in enumerate(groups):
        fitted_to = [each for index, each in enumerate(presses) if index not in held]
        judged_on = MemoryGroups(side_by_side([presses[index] for index in held]))
        for way in WAYS:
            say(f'{way}, part {number + 1} of {len(groups)}')
            candidate, _ = _fitted(network, way, fitted_to)
            errors[way].append(collect(candidate, judged_on))
    mae = {way: float(torch.cat([e.error for e in errors[way]]).abs().mean()) for way in WAYS}
    way = choose(mae)
    say(f'{way}, all presses')
    final, gain = _fitted(network, way, presses)
    if final.deviation is not None:
        # Presses were held out: errors on what was fitted to are too small.
        calibrate_deviation(final, joined(errors[way]))
    return Adapted(final, way, gain, mae, len(presses), pressed_s)


def choose(mae: dict[str, float]) -> str:
    """Return the way that wins: each larger change must earn its keep."""
    best = WAYS[0]
    for way in WAYS[1:]:
        if mae[way] < min(LEAST_WIN * mae[best], mae[best] - LEAST_WIN_N):
            best = way
    return best


def side_by_side(presses: Sequence[Sample]) -> Sequences:
    """Return presses as sequences of one sensor; windows of unknown force do not count."""
    sequences = stack(presses, [0] * len(presses))
    known = torch.isfinite(sequences.force)
    force = torch.where(known, sequences.force, 0.0)
    return replace(sequences, force=force, valid=sequences.valid & known)


def _fitted(network: FgerNetwork, way: str, presses: Sequence[Sample]) -> tuple[FgerNetwork, float]:
    """Return a copy fitted in one of `WAYS`, and its gain."""
    if way == 'unchanged':
        return with_gain(network, 1.0), 1.0
    known, seen = _forces(network, presses)
    gain = fit_scale(seen, known).force_scale
    scaled = with_gain(network, gain)
    return (scaled if way == 'gain' else tuned(scaled, side_by_side(presses))), gain


def _forces(
    network: FgerNetwork, presses: Sequence[Sample]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return known forces and estimates of all windows where the force is known [N]."""
    sequences = side_by_side(presses)
    force, _ = estimate(network, sequences)
    valid = sequences.valid
    return (
        sequences.force[valid].numpy().astype(np.float64),
        force[valid].numpy().astype(np.float64),
    )


def _check(network: FgerNetwork, presses: Sequence[Sample]) -> float:
    """Return for how long a force is known; refuse what cannot be fitted to."""
    known, seen = _forces(network, presses)
    pressed_s = np.count_nonzero(known > SMALLEST_FORCE_N) * network.config.window_us / 1e6
    if pressed_s < SHORTEST_PRESSED_S:
        raise CalibrationError(
            f'{pressed_s:.1f} s of known forces above {SMALLEST_FORCE_N} N: press for at least'
            f' {SHORTEST_PRESSED_S} s'
        )
    together = float(np.corrcoef(known, seen)[0, 1])
    if not together > LEAST_CORRELATION and np.ptp(known) > SMALLEST_FORCE_N:
        raise CalibrationError(
            f'known force and estimate have a correlation of {together:.2f}: check the axis and the'
            ' sign of the reference, and its clock with `mixtac align`'
        )
    gain = fit_scale(seen, known).force_scale
    if not GAINS[0] < gain < GAINS[1]:
        raise CalibrationError(
            f'the known forces are {gain:.2f} times the estimates: no gel explains that; check the'
            ' unit of the reference'
        )
    return pressed_s
