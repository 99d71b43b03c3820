# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Adapting a model to a sensor: leave it unchanged, apply one gain, or tune its last layers.

Each way is fitted to all presses but some and judged on those, in turn. The smallest error wins,
and a larger change has to win by a margin. The winner is then fitted to all presses.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from torch import Tensor, nn

from mixtac_fger import fger_net
from mixtac_fger.estimator import ADAPTED_KEY, CALIBRATED_KEY, SERIAL_KEY
from mixtac_fger.force_calibration import GAINS
from mixtac_fger.pull_calibration import PullCalibration
from mixtac_fger.weights import Model, ModelCard, read_model, save_model
from mixtac_learning.adapt.presses import (
    Load,
    PressSet,
    fit_sideways,
    folds,
    gather_presses,
    parse_load,
)
from mixtac_learning.judge.estimators import stream
from mixtac_learning.judge.metrics import SMALLEST_FORCE_N, CalibrationError, fit_scale
from mixtac_learning.network import FgerNetwork, model_of, network_of
from mixtac_learning.train.batches import MemoryGroups, Sequences, stack
from mixtac_learning.train.config import TrainingSettings
from mixtac_learning.train.frame_stage import NetworkWithGains
from mixtac_learning.train.loop import TrainingLoop
from mixtac_learning.train.stages import (
    Errors,
    SequenceStage,
    calibrate_deviation,
    collect,
    estimate,
    joined,
)
from mixtac_learning.trials.bags import BagSource, bag_sources
from mixtac_learning.trials.samples import Sample
from mixtac_learning.trials.trial import ForceLabel, camera_end_us, camera_start_us, sensor_of
from mixtac_node.files import write_json
from mixtac_node.topics import REFERENCE

Report = Callable[[str], None]


def with_gain(network: FgerNetwork, gain: float) -> FgerNetwork:
    """Return a network whose forces are `gain` times those of `network`; see `fger_net.with_gain`.

    Args:
        network: Not changed.
        gain: Above 0.

    Raises:
        ModelError: The gain is no such number.
    """
    return network_of(fger_net.with_gain(model_of(network, ModelCard()), gain))


SETTINGS = TrainingSettings(
    recurrent_epochs=8, recurrent_rate=1e-3, weight_decay=0.0, mirror=False, force_weight=2.0
)
"""Few updates at a low rate."""
PULL = 0.01
"""Weight of the sum of squared changes of the weights in the loss [N]."""


@dataclass(eq=False)
class LastLayers(SequenceStage):
    """Trains the layers that end in a force: MLP_df and MLP_corr."""

    start: list[Tensor] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Keep where the weights start."""
        super().__post_init__()
        self.name = 'last layers'
        self.start = [parameter.detach().clone() for parameter in self.parameters()]

    def begin(self) -> None:
        """Begin with the weights as they are."""

    def parameters(self) -> list[nn.Parameter]:
        """Return what is trained."""
        network = self.model.network
        return [*network.increment.parameters(), *network.correction.parameters()]

    def losses(self, random: torch.Generator) -> Iterator[Tensor]:
        """Yield the losses of one epoch, each with the pull towards the start."""
        for loss in super().losses(random):
            pairs = zip(self.parameters(), self.start, strict=True)
            change = torch.stack([(now - then).square().sum() for now, then in pairs]).sum()
            yield loss + PULL * change


def tuned(network: FgerNetwork, data: Sequences, seed: int = 0) -> FgerNetwork:
    """Return a copy of a network with its last layers fitted to presses.

    Args:
        network: Not changed.
        data: Presses side by side, all of one sensor.
        seed: Random seed for the borders between updates.

    Raises:
        TrainingError: The loss became NaN.
    """
    model = NetworkWithGains(network.config, 1)
    model.network = copy.deepcopy(network)
    loop = TrainingLoop(model, seed=seed, weight_decay=SETTINGS.weight_decay)
    loop.run([LastLayers(model, MemoryGroups(data), SETTINGS)])
    return model.network.eval()


WAYS = ('unchanged', 'gain', 'last_layers')
"""From the least change to the largest."""
FOLDS = 3
LEAST_WIN = 0.97
"""A larger change must bring the held-out error below this part of the smaller one's."""
LEAST_WIN_N = 1e-3
"""And by this much [N]."""
SHORTEST_PRESSED_S = 2.0
"""Known forces above `SMALLEST_FORCE_N` that are needed [s]."""
LEAST_CORRELATION = 0.7
"""Smallest correlation of estimate and known force that belong together (estimate)."""


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
    network: FgerNetwork, presses: Sequence[Sample], report: Report = lambda _text: None
) -> Adapted:
    """Adapt a network to the sensor that made the presses.

    Args:
        network: Not changed.
        presses: At least two; forces are NaN where unknown.
        report: Called with what is being done.

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
            report(f'{way}, part {number + 1} of {len(groups)}')
            candidate, _ = _fitted(network, way, fitted_to)
            errors[way].append(collect(candidate, judged_on))
    mae = {way: float(torch.cat([e.error for e in errors[way]]).abs().mean()) for way in WAYS}
    way = choose(mae)
    report(f'{way}, all presses')
    final, gain = _fitted(network, way, presses)
    if final.deviation is not None:
        # Presses were held out: errors on what was fitted to are too small.
        calibrate_deviation(final, joined(errors[way]))
    return Adapted(final, way, gain, mae, len(presses), pressed_s)


def choose(mae: dict[str, float]) -> str:
    """Return the way that wins: each larger change must be clearly better."""
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
    gain = fit_scale(seen, known)
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
    gain = fit_scale(seen, known)
    if not GAINS[0] < gain < GAINS[1]:
        raise CalibrationError(
            f'the known forces are {gain:.2f} times the estimates: no gel explains that; check the'
            ' unit of the reference'
        )
    return pressed_s


def run_adaptation(
    bags: Sequence[Path],
    model: Path,
    out: Path,
    *,
    loads: Sequence[str] = (),
    sideways: Sequence[str] = (),
    reference: str = REFERENCE,
    json: Path | None = None,
    serial: str = '',
) -> None:
    """Adapt a model, write weight file and card, print what was chosen and why.

    Args:
        bags: Recordings of one sensor, or folders of them.
        model: Weight file to start from.
        out: Weight file to write.
        loads: Known loads, texts like `0.5:3.0-6.0`; empty to use the reference in the bags.
        sideways: Known sideways loads in the first bag, texts of the same form; empty for none.
        reference: Topic of the reference force.
        json: File for the figures; None for none.
        serial: Serial number of the sensor's camera, so that the node refuses other cameras; empty
            to allow any.

    Raises:
        CalibrationError: The presses cannot be used; the text explains why.
        MixtacError: A bag or the model cannot be used.
    """
    torch.set_num_threads(1)
    console = Console(markup=False)
    start = read_model(model)
    network = network_of(start)
    known, pulls = ([parse_load(text) for text in texts] for texts in (loads, sideways))
    sources = _sources(bags, reference, loads=bool(known))
    console.print(f'reading {len(sources)} recordings')
    trials = (each.load_camera() if known else each.load() for each in sources)
    presses = gather_presses(network, trials, known)
    with console.status('adapting') as status:
        adapted = adapt(network, presses.presses, status.update)
    figures = adaptation_figures(adapted, presses)
    content = model_of(adapted.network, ModelCard())
    if pulls:
        fit = sideways_fit(content, sources[0], pulls)
        gain, gain_sd = fit.elsewhere(1.0)
        content = fger_net.with_sideways_gain(content, gain)
        figures |= {'sideways_gain': round(gain, 4), 'sideways_gain_sd': round(gain_sd, 4)}
        console.print(f'sideways gain {gain:.3f} +- {gain_sd:.3f}; at the pulls {fit.gain:.3f}')
    # What the model was calibrated or adapted to before is no longer so.
    before = {k: v for k, v in start.card.training.items() if k not in (SERIAL_KEY, CALIBRATED_KEY)}
    training = before | {
        ADAPTED_KEY: {'from': model.name, 'bags': [each.name for each in sources]} | figures
    }
    if serial:
        training[SERIAL_KEY] = serial
    save_model(out, replace(content, card=ModelCard(training, {'adaptation': figures})))
    _report(console, adapted, presses)
    console.print(f'wrote {out}')
    write_json(json, {'model': str(model), 'out': str(out)} | figures)


def sideways_fit(model: Model, source: BagSource, loads: Sequence[Load]) -> PullCalibration:
    """Return the gain of the sideways force by known pulls.

    Args:
        model: Calibrated for the normal force.
        source: Recording of the pulls.
        loads: Size of each pull, and when.

    Raises:
        MixtacError: The recording or the model cannot be used, or not calibrated by these pulls.
    """
    trial = source.load_camera()
    start_us = camera_start_us(trial)
    times = np.array([start_us, camera_end_us(trial)], np.float64)
    found = stream(model, replace(trial, truth=ForceLabel(times, np.zeros(2))))
    across = np.full((len(found.t_us), 2), np.nan) if found.across is None else found.across
    return fit_sideways((found.t_us - start_us) / 1e6, across, loads)


def _sources(bags: Sequence[Path], reference: str, *, loads: bool) -> list[BagSource]:
    """Return the recordings to adapt by, without test trials of a data set.

    Raises:
        CalibrationError: There are none, or of several sensors, or too many for known loads.
    """
    found = [each for bag in bags for each in bag_sources(bag, reference)]
    sources = [each for each in found if each.origin.get('split', 'train') != 'test']
    if not sources:
        raise CalibrationError(
            f'all {len(found)} recordings are test trials of a data set, on which the adapted'
            ' model is to be judged',
            remedy='give other recordings',
        )
    origins = [each.origin for each in sources]
    sensors = {sensor_of(origin, '') for origin in origins}
    if len(sensors) > 1:
        raise CalibrationError(
            f'the recordings are from {len(sensors)} sensors, and each has its own gel',
            remedy='give recordings of one sensor',
        )
    if loads and len(sources) != 1:
        raise CalibrationError(
            f'known loads belong to one recording, but there are {len(sources)}',
            remedy='give one bag',
        )
    return sources


def adaptation_figures(adapted: Adapted, presses: PressSet) -> dict[str, Any]:
    """Return what was chosen and why, JSON-ready; forces in N, times in s."""
    held_out = {f'held_out_mae_{way}': round(v, 4) for way, v in adapted.held_out_mae.items()}
    return {
        'chosen': adapted.way,
        'gain': round(adapted.gain, 4),
        'presses': adapted.presses,
        'pressed_s': round(adapted.pressed_s, 1),
        'recorded_s': round(presses.used_s, 1),
    } | held_out


def _report(console: Console, adapted: Adapted, presses: PressSet) -> None:
    if presses.left_out_s > 0.0:
        console.print(f'left out {presses.left_out_s:.0f} s beyond the first minute')
    errors = ', '.join(f'{way} {mae:.3f} N' for way, mae in adapted.held_out_mae.items())
    console.print(f'{adapted.presses} presses; error on held-out presses: {errors}')
    console.print(f'chosen: {adapted.way}, gain {adapted.gain:.3f}')
