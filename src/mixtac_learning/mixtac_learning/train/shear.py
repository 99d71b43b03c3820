# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training of the head for sideways force and torsion (`mixtac_fger.shear`) beside a trained model.

The head is linear in its weights: ridge regression, on frames and on what changes between two
frames, among weights that have no favourite direction. Forces are divided by the stiffness of the
gel, which the simulator knows and no picture shows, so that weights are those of a gel of usual
stiffness.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from mixtac_fger.config import FgerConfig
from mixtac_fger.features import bin_cells
from mixtac_fger.fger_net import checked_config
from mixtac_fger.frame_network import frame_maps, frame_step, frame_weights, row_scratch
from mixtac_fger.recurrent_network import RecurrentPath
from mixtac_fger.shear import HIGHEST, NEWTONS, POWERS, cell_means
from mixtac_fger.weights import Model, ModelCard, Tensors, read_model
from mixtac_learning.trials.samples import make_sample
from mixtac_learning.trials.trial import DatasetError, TrialArrays
from mixtac_node.files import replacing
from mixtac_sim.world.training_trials import TrialSpec, stiffness

Array = NDArray[np.float32]
RIDGE = 0.03
"""Added to the diagonal over its mean; from 0.003 to 0.1 the error of held-out sensors is flat."""
RADII = (0.7, 1.6, 2.5, 3.5, 4.3)
"""Distances from the middle of the grid between which weights are interpolated [cells]."""
LEAST_N = 0.02
"""Changes between two frames count where the normal force is at least this [N]."""


@dataclass(frozen=True, slots=True, eq=False)
class ShearSample:
    """One trial: N frames, and what changed from each to the next.

    Attributes:
        shown: Mean displacement of each cell, right and down, float32 [N, rows, columns, 2].
        force: Normal force that the frame shows [N], float32 [N].
        wanted: Right, up [N], torque [N mm] over the stiffness of the gel, float32 [N, 3].
        flow: Sum of the flow of events to the next frame, float32 [N - 1, rows, columns, 2].
        between: Mean of the normal force there [N], float32 [N - 1].
        stiffness: Of the gel over the usual one, float32 [1].
    """

    shown: Array
    force: Array
    wanted: Array
    flow: Array
    between: Array
    stiffness: Array


@dataclass(frozen=True, slots=True)
class ShearRecipe:
    """Samples of the head for one model.

    Attributes:
        base: Weight file of the model.
    """

    base: Path
    suffix = '.shear.npz'

    def fingerprint(self) -> dict[str, Any]:
        """Return what changes a sample."""
        tensors = read_model(self.base).tensors
        total = sum(float(np.abs(tensors[name]).sum()) for name in sorted(_without_head(tensors)))
        return {'kind': 'shear 1', 'model': f'{total:.9e}'}

    def write(self, trial: TrialArrays, path: Path) -> None:
        """Prepare a simulated trial and write it, whole or not at all.

        Raises:
            DatasetError: The sideways force is not known, or as `make_sample`.
        """
        model = read_model(self.base)
        sample = shear_sample(checked_config(model), model.tensors, trial)
        with replacing(path) as scratch, Path(scratch).open('wb') as file:
            np.savez(file, **asdict(sample))


def shear_sample(config: FgerConfig, tensors: Tensors, trial: TrialArrays) -> ShearSample:
    """Return the sample of a trial.

    Raises:
        DatasetError: The sideways force is not known, or as `make_sample`.
    """
    if trial.across is None:
        raise DatasetError(f'trial {trial.origin} has no known sideways force')
    sample = make_sample(config, trial, trial.label(), trial.origin)
    weights, scratch = frame_weights(tensors, config), row_scratch(config)
    maps, feature = frame_maps(config), np.empty(config.frame_size, np.float32)
    channels = [config.frame_channels.index(name) for name in ('flow_x', 'flow_y')]
    path = RecurrentPath(config, tensors)
    count, windows = len(sample.frame_inputs), len(sample.window_end_us)
    cells = bin_cells(config.frame_shape, config.grid_shape)
    shown = np.zeros((count, *config.grid_shape, 2), np.float32)
    frame_force, force = np.zeros(count, np.float32), np.zeros(windows, np.float32)
    for window, slot in enumerate(sample.slots.tolist()):
        if slot >= 0:
            inputs = sample.frame_inputs[slot].astype(np.float32)
            frame_force[slot] = frame_step(inputs, weights, maps, scratch, feature)
            cell_means(*inputs[channels], *cells, shown[slot])
            path.correct(feature, int(sample.lags[window]))
        force[window] = path.step(sample.event_features[window].astype(np.float32))
    kept = config.reference_frames - 1
    middle = ((trial.exposure_start_us + trial.exposure_end_us) // 2)[kept:]
    seen = np.unique(sample.slots[sample.slots >= 0])
    place = np.searchsorted(sample.window_end_us, middle[seen], side='right')
    sums = np.cumsum(sample.event_features[..., :2], axis=0, dtype=np.float32)
    sums = np.concatenate([np.zeros_like(sums[:1]), sums])[place]
    at_frames = force[np.minimum(place, windows - 1)]
    fields = {name: trial.origin[name] for name in TrialSpec.__dataclass_fields__}
    share = stiffness(TrialSpec(**fields))
    wanted = trial.across.at(middle[seen]) / np.array(NEWTONS) / share
    return ShearSample(
        shown[seen],
        frame_force[seen],
        wanted.astype(np.float32),
        np.diff(sums, axis=0),
        0.5 * (at_frames[1:] + at_frames[:-1]),
        np.array([share], np.float32),
    )


def _load(path: Path) -> ShearSample:
    with np.load(path) as file:
        return ShearSample(**{name: file[name] for name in ShearSample.__slots__})


def _kernels(shape: tuple[int, int]) -> tuple[Array, Array]:
    """Return what weights are sums of: laws that do not change when the picture is turned.

    A turned pull is read as the same pull, turned: the weights of x and y are one law. Fitted each
    for itself to the pulls of a few sensors, y was read larger than x by 6 to 13 %.

    Args:
        shape: Rows and columns of the grid, whose cells are squares.

    Returns:
        For right and up, along the displacement and along the way from the middle, [2, 2 n, rows,
        columns, 2]; for the torque, across that way [1, n, rows, columns, 2]; n is that of `RADII`.
    """
    y, x = (each - 0.5 * (size - 1) for each, size in zip(np.indices(shape), shape, strict=True))
    distance = np.maximum(np.hypot(x, y), 1e-9)
    share = np.stack([np.interp(distance, RADII, one) for one in np.eye(len(RADII))])[..., None]
    away = np.stack([x, y], axis=-1) / distance[..., None]
    same = np.eye(2)[:, None, None, None]
    along = np.moveaxis(away, -1, 0)[:, None, ..., None] * away - 0.5 * same
    up = np.array([1.0, -1.0])[:, None, None, None, None]
    sideways = up * np.concatenate([share * same, share * along], axis=1)
    turn = share * away[..., ::-1] * np.array([1.0, -1.0])
    return sideways, turn[None]


def _ridge(parts: list[tuple[Array, Array, Array]]) -> Array:
    """Return weights [3, inputs] of cells, normal force and what is wanted."""
    sideways, turn = _kernels(parts[0][0].shape[1:3])
    weights: list[Array] = []
    for first, kernels in ((0, sideways), (2, turn)):
        square: Any = 0.0
        product: Any = 0.0
        laws = kernels.reshape(*kernels.shape[:2], -1)
        for cells, force, wanted in parts:
            for axis, law in enumerate(laws, first):
                base = np.clip(force, 0.0, HIGHEST)[:, None] ** POWERS[axis]
                inputs = base * (cells.reshape(len(cells), -1) @ law.T)
                square = square + inputs.T @ inputs
                product = product + inputs.T @ wanted[:, axis]
        square[np.diag_indices(len(square))] += RIDGE * np.trace(square) / len(square)
        weights += [np.linalg.solve(square, product) @ law for law in laws]
    return np.asarray(weights, np.float32)


def _told(cells: Array, force: Array, weights: Array) -> NDArray[np.float64]:
    """Return what weights make of cells, [n, 3]."""
    base = np.clip(force, 0.0, HIGHEST)[:, None] ** np.array(POWERS)
    return np.asarray(base * (cells.reshape(len(cells), -1) @ weights.T), np.float64)


def _changes(sample: ShearSample) -> tuple[Array, Array, Array]:
    kept = np.abs(sample.between) >= LEAST_N
    return sample.flow[kept], sample.between[kept], np.diff(sample.wanted, axis=0)[kept]


def fit_head(trained: list[ShearSample], held: list[ShearSample]) -> dict[str, NDArray[Any]]:
    """Return the tensors of the head.

    Args:
        trained: Samples for the weights.
        held: Samples of other sensors, for the deviations.
    """
    frame = _ridge([(each.shown, each.force, each.wanted) for each in trained])
    event = _ridge([_changes(each) for each in trained])
    rows, steps, changes = [], [], []
    for each in held or trained:
        value = _told(each.shown, each.force, frame)
        rows.append(np.stack([value, each.wanted * each.stiffness - value]))
        flow, between, change = _changes(each)
        step = _told(flow, between, event)
        steps.append(step)
        changes.append(change - step)
    value, error = np.concatenate(rows, axis=1)
    moved, missed = np.concatenate(steps), np.concatenate(changes)
    shares = np.zeros((3, 3), np.float32)
    for axes in ([0, 1], [2]):
        terms = np.stack([np.ones(value[:, axes].size), value[:, axes].ravel() ** 2], axis=1)
        found, _ = nnls(terms, error[:, axes].ravel() ** 2)
        last = (missed[:, axes] ** 2).sum() / max((moved[:, axes] ** 2).sum(), 1e-12)
        shares[axes] = np.sqrt([*found, last])
    return {
        'shear.frame.weight': frame,
        'shear.event.weight': event,
        'shear.unit': np.ones(3, np.float32),
        'shear.deviation': shares,
    }


def figures(held: dict[str, list[ShearSample]], frame: Array) -> dict[str, dict[str, float]]:
    """Return the errors of frames alone by profile; the gain of a sensor fits its own trial."""
    found = {}
    for profile, samples in sorted(held.items()):
        rows = []
        for each in samples:
            value = _told(each.shown, each.force, frame)
            true = each.wanted.astype(np.float64) * each.stiffness
            gain = (value[:, :2] * true[:, :2]).sum() / max((value[:, :2] ** 2).sum(), 1e-9)
            errors = (true[:, :2] - value[:, :2], true[:, :2] - gain * value[:, :2], true[:, :2])
            turned = (true[:, 2] - value[:, 2], true[:, 2])
            rows.append([np.abs(each).mean() for each in (*errors, *turned)])
        names = (
            *('sideways_mae', 'sideways_mae_with_gain', 'sideways_size'),
            *('torque_mae_nmm', 'torque_size_nmm'),
        )
        means = np.mean(rows, axis=0).tolist()
        found[profile] = {name: round(value, 4) for name, value in zip(names, means, strict=True)}
    return found


def _without_head(tensors: Tensors) -> list[str]:
    return [name for name in tensors if not name.startswith('shear.')]


def train_shear(
    base: Model, trained: Sequence[Path], held: Sequence[Path], facts: dict[str, Any]
) -> Model:
    """Return a model with a head beside it; its other weights are the same.

    Args:
        base: The model.
        trained: Samples to train on.
        held: Samples of other sensors.
        facts: Where the samples came from, for the model card.
    """
    samples = {path: _load(path) for path in (*trained, *held)}
    tensors = fit_head([samples[path] for path in trained], [samples[path] for path in held])
    by_profile: dict[str, list[ShearSample]] = {}
    for path in held:
        by_profile.setdefault(path.name.split('_')[0], []).append(samples[path])
    errors = figures(by_profile, tensors['shear.frame.weight'])
    card = ModelCard(
        base.card.training | {'shear': facts | {'ridge': RIDGE}},
        base.card.metrics | {HELD_OUT: errors},
    )
    kept = {name: base.tensors[name] for name in _without_head(base.tensors)}
    model = replace(base, config=base.config | {'shear': True}, card=card, tensors=kept | tensors)
    checked_config(model)
    return model


HELD_OUT = 'sideways_held_out_sensors'
"""Figures of the head in a model card."""
