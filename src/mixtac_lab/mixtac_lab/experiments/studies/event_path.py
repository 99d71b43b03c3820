# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What events tell of changes of the force, by how the events of a window are put together.

FGER-Net of the paper takes the maximum over the events of a window, of every channel of a
perceptron that sees one event. Linear maps to the change of the force, fitted to some trials of a
session and judged on others, show what is left of it then, and what sums would leave. A trained
network is judged by the same changes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from mixtac_cli.figures import make_table
from mixtac_cli.options import JsonFile
from mixtac_fger.config import ConfigError
from mixtac_fger.weights import find_model, read_model
from mixtac_lab.experiments.paper.vibration import cell_sums
from mixtac_lab.experiments.sizes import DYNAMIC, PAPER, TABLE_SIZES, Sizes
from mixtac_lab.experiments.studies.models import table_data
from mixtac_learning.judge.metrics import measure
from mixtac_learning.paper.config import PaperConfig
from mixtac_learning.paper.networks import EventRecurrence, PaperNetwork, paper_network_of
from mixtac_learning.paper.samples import SETTLE_FRAMES, PaperSample, make_paper_sample
from mixtac_learning.paper.segments import Segment
from mixtac_learning.train.paper_stage import run_stretches
from mixtac_learning.train.run import training_sources
from mixtac_learning.trials.store import CachedSource
from mixtac_learning.trials.trial import TrialArrays
from mixtac_node.files import write_json

WINDOWS = (1, 5, 10, 20, 50)
"""Lengths of the changes, in windows of 2 ms."""
CELL_PX = 44
"""Side of a cell [px]: eight columns and six rows."""
RIDGE = 0.01
"""Penalty, in mean squares of the standardised features."""
EVERY = 3
"""One trial in so many is judged; the maps are fitted to the others."""
LARGEST_N = 0.5
"""Larger changes are not judged: they are those of synchronising impulses [N]."""
Features = dict[str, NDArray[np.float64]]


def features_of(trial: TrialArrays, sample: PaperSample, config: PaperConfig) -> Features:
    """Return features of each window by how its events are put together, [windows, n].

    Args:
        trial: Its events, and the frames before the first contact for their gradients.
        sample: The same trial as the paper's networks see it.
        config: Of the network.
    """
    torch.manual_seed(0)
    encoder = EventRecurrence(config).encoder
    windows = len(sample.force)
    packet = torch.from_numpy(np.repeat(np.arange(windows), np.diff(sample.starts)))
    points = torch.from_numpy(np.array(sample.points, np.float32))
    with torch.no_grad():
        cells = encoder(points, packet, windows)
        for layer in encoder.layers:
            if isinstance(layer, torch.nn.Linear):
                layer.reset_parameters()
        largest = encoder(points, packet, windows)
        each = torch.relu(encoder.layers(points))
        total = torch.zeros(windows, encoder.size).index_add(0, packet, each)
    ends = sample.window_end_us
    span_us = (int(ends[0]) - config.window_us, int(ends[-1]))
    image = trial.frames[:SETTLE_FRAMES].mean(axis=0)
    across, down, on, off = cell_sums(trial.events, image, span_us, config.window_us, CELL_PX)
    counts = np.concatenate([on, off], 1)
    return {
        'perceptron, random weights, maximum (paper)': largest.double().numpy(),
        'perceptron, random weights, sum': total.double().numpy(),
        'perceptron that begins with cells, maximum': cells.double().numpy(),
        'number of events': (on + off).sum(1, keepdims=True),
        'number of ON and of OFF events': np.stack([on.sum(1), off.sum(1)], 1),
        'whether there are ON, OFF events by cell': np.minimum(counts, 1.0),
        'ON and OFF events by cell': counts,
        'flow by cell, with the gradient of a frame': np.concatenate([across, down], 1),
    }


def changes(
    features: NDArray[np.float64], force: NDArray[np.float32], windows: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return sums of features over stretches of windows, [n, size], and changes of force [N], [n].

    Stretches overlap by half; those of synchronising impulses are left out.
    """
    sums = np.concatenate([np.zeros((1, features.shape[1])), np.cumsum(features, 0)])
    starts = np.arange(1, len(force) - windows, max(windows // 2, 1))
    change = (force[starts + windows - 1] - force[starts - 1]).astype(np.float64)
    kept = np.abs(change) < LARGEST_N
    return (sums[starts + windows] - sums[starts])[kept], change[kept]


def linear_r2(
    features: Sequence[NDArray[np.float64]], forces: Sequence[NDArray[np.float32]], windows: int
) -> float:
    """Return R2 of the best linear map to changes of the force, on trials without fit.

    Args:
        features: By trial, [windows, n].
        forces: By trial [N].
        windows: Length of a change.
    """
    pairs = [changes(each, force, windows) for each, force in zip(features, forces, strict=True)]
    judged = [k % EVERY == EVERY - 1 for k in range(len(pairs))]
    (inputs, known), (others, truth) = (
        [np.concatenate(part) for part in zip(*chosen, strict=True)]
        for chosen in (
            [pair for pair, out in zip(pairs, judged, strict=True) if not out],
            [pair for pair, out in zip(pairs, judged, strict=True) if out],
        )
    )
    centre, scale = inputs.mean(0), inputs.std(0) + 1e-9
    even = (inputs - centre) / scale
    square = even.T @ even / len(even) + RIDGE * np.eye(len(scale))
    gains = np.linalg.solve(square, even.T @ (known - known.mean()) / len(even))
    return measure(truth, (others - centre) / scale @ gains + known.mean()).r2


def network_rows(network: PaperNetwork, samples: Sequence[PaperSample]) -> list[dict[str, float]]:
    """Return slope, correlation and error of the changes that a network finds, by their length.

    Stretches begin at the true force with an empty memory, which the first window does not tell
    much without; trials are those that `linear_r2` judges.
    """
    longest = max(WINDOWS)
    chosen = [
        Segment(trial, start, start + longest)
        for trial in range(EVERY - 1, len(samples), EVERY)
        for start in range(1, len(samples[trial].force) - longest, longest)
    ]
    with torch.no_grad():
        found, known = (part.numpy() for part in run_stretches(network, samples, chosen))
    before = np.array([samples[s.trial].force[s.start - 1] for s in chosen])
    rows = []
    for windows in WINDOWS[1:]:
        change, truth = found[windows - 1] - before, known[windows - 1] - before
        kept = np.abs(truth) < LARGEST_N
        change, truth = change[kept], truth[kept]
        varies = change.std() > 0.0 and truth.std() > 0.0
        rows.append(
            {
                'ms': 2.0 * windows,
                'slope': round(float(np.polyfit(truth, change, 1)[0]), 3),
                'correlation': round(float(np.corrcoef(truth, change)[0, 1]), 3) if varies else 0.0,
                'mae': round(float(np.abs(change - truth).mean()), 5),
                'mae_of_none': round(float(np.abs(truth).mean()), 5),
            }
        )
    return rows


def held_errors(samples: Sequence[PaperSample]) -> dict[str, float]:
    """Return the mean error [N] of a network without events that knows each frame's force exactly.

    Returns:
        `exposure`: the mean force of the exposure, held until the next frame arrives; `arrival`:
        the force when the frame arrives, held as long.
    """
    errors: dict[str, list[NDArray[np.float32]]] = {'exposure': [], 'arrival': []}
    for sample in samples:
        latest = np.maximum.accumulate(np.where(sample.slots >= 0, np.arange(len(sample.slots)), 0))
        exposure = sample.frame_force[sample.slots[latest]]
        errors['exposure'].append(np.abs(exposure - sample.force))
        errors['arrival'].append(np.abs(sample.force[latest] - sample.force))
    return {name: round(float(np.concatenate(each).mean()), 4) for name, each in errors.items()}


def event_path(
    weights: Annotated[
        list[str] | None,
        typer.Option('--model', help='Weight file of a network of the paper; may be repeated.'),
    ] = None,
    size: Annotated[str, typer.Option(help='As in "mixtac experiments models".')] = 'reduced',
    out: Annotated[Path, typer.Option(help='Trials are kept there.')] = Path('runs/models'),
    json: JsonFile = None,
) -> None:
    """Show what events tell of changes of the force, by how a window's events are pooled."""
    if size not in TABLE_SIZES:
        raise ConfigError(f'unknown size {size!r}', remedy=f'choose from {", ".join(TABLE_SIZES)}')
    torch.set_num_threads(1)
    networks = {name: paper_network_of(read_model(find_model(name))) for name in weights or ()}
    sizes = TABLE_SIZES[size]
    sources = dynamic_trials(sizes, out)
    trials = [source.load() for source in track(sources, 'trials', transient=True)]
    config = PaperConfig.from_dict({'model': 'events'} | sizes.paper_network)
    samples = [make_paper_sample(config, trial) for trial in trials]
    features = [
        features_of(trial, sample, config) for trial, sample in zip(trials, samples, strict=True)
    ]
    forces = [sample.force for sample in samples]
    linear: list[dict[str, Any]] = []
    for name in features[0]:
        r2 = [linear_r2([each[name] for each in features], forces, n) for n in WINDOWS]
        linear.append({'features': name, 'r2': [round(each, 3) for each in r2]})
    console = Console(markup=False)
    headings = ('R2 of a linear map from', *(f'{2 * n} ms' for n in WINDOWS))
    lines = [(row['features'], *(f'{each:.2f}' for each in row['r2'])) for row in linear]
    console.print(make_table(f'changes of the force, {size}, simulated', headings, lines))
    held = held_errors(samples)
    console.print(
        f'the exact force of each frame, held until the next: {held["exposure"]} N off; that at its'
        f' arrival: {held["arrival"]} N'
    )
    trained: Mapping[str, list[dict[str, float]]] = {
        name: network_rows(network, samples) for name, network in networks.items()
    }
    for name, rows in trained.items():
        table = [tuple(f'{value:.3f}' for value in row.values()) for row in rows]
        console.print(make_table(f'increments of {name}', tuple(rows[0]), table))
    result = {'size': size, 'protocol': PAPER, 'simulated': True, 'trials': len(trials)}
    write_json(json, {**result, 'linear': linear, 'held': held, 'networks': trained})


def dynamic_trials(sizes: Sizes, out: Path) -> list[CachedSource]:
    """Return the dynamic trials of the session that the table of all models trains on."""
    sources = training_sources(table_data(sizes, 'events', PAPER))
    kept = [source for source in sources if source.origin['profile'] == DYNAMIC]
    return [CachedSource(source, out / 'trials') for source in kept]
