# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Size and speed of the networks (paper, section III-B)."""

from __future__ import annotations

import time
import timeit
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from mixtac_fger import config as fger
from mixtac_fger.estimator import open_estimator
from mixtac_fger.fger_net import checked_config
from mixtac_fger.streaming import ForceEstimator, warm_up
from mixtac_fger.weights import DEFAULT_MODEL, find_model, read_model
from mixtac_learning.experiments.harness import (
    NETWORKS,
    PRESET,
    Context,
    Outcome,
    Row,
    Value,
    experiment,
)
from mixtac_learning.judge.estimators import windows_of
from mixtac_learning.network import count_parameters
from mixtac_learning.paper.config import PaperConfig
from mixtac_learning.paper.networks import PaperNetwork, build, one_cycle, operations_per_cycle
from mixtac_learning.train.config import OURS
from mixtac_learning.trials.trial import SimulatedSource
from mixtac_sim.world.plans import TrialSpec

PARAMETERS = 0.517e6
"""Parameters of the paper's network."""
FLOPS = 2.0e9
"""Operations of the paper's network per frame interval."""
LATENCY_MS = 0.87
"""Latency of the paper's network on an RTX 4090 [ms]."""
SIZE_PLACE = 'section III-B'
REPETITIONS = 10
"""Timed calls of the paper's network."""
DEVICE_SEED = 910_000
"""Seed of the sensor on whose trial the window step is timed."""
TRIAL_SEED = 911_000
"""Seed of that trial."""


@experiment
def model(context: Context) -> Outcome:
    """Parameters, operations and latency of the networks.

    The paper's network has 0.517 M parameters, 2.0 GFLOPs and 0.87 ms on an NVIDIA RTX 4090. Its
    widths are not stated; ours reach both totals.

    Here the latency is on this CPU, one thread; other work on the machine adds to it. The window
    step reads the events of 2 ms and returns a force. The frame step runs beside it, 25 times a
    second. The paper does not state what its latency includes.
    """
    bar = context.progress.add_task('size and latency', total=2)
    rows = paper_rows()
    context.progress.advance(bar)
    rows += our_rows(context.sizes.latency_seconds)
    context.progress.advance(bar)
    data = (
        'shipped small model; random weights of the paper network at 346 x 260; virtual sensor,'
        f' preset {PRESET}, in real time for the window step'
    )
    return Outcome(data, rows)


def _row(name: str, value: Value, unit: str, text: str, paper: float | None = None) -> Row:
    return Row(name, value, paper, SIZE_PLACE, unit, text, simulated=False)


def paper_rows() -> list[Row]:
    """Return size and speed of the paper's network."""
    config = PaperConfig()
    network = build(config)
    name, text = NETWORKS['fger'].label, 'native resolution, 512 events per packet'
    thread = f'{text}; PyTorch on this CPU, one thread'
    operations = _one(operations_per_cycle(config))
    batch = one_cycle(config)
    points = torch.rand(config.events_per_packet, 4)
    packet = torch.zeros(config.events_per_packet, dtype=torch.int64)
    state = network.initial_state(1)
    recurrence: Any = network.recurrence
    cycle_ms = _timed(lambda: network(batch, network.initial_state(1)), network)
    packet_ms = _timed(
        lambda: recurrence.step(recurrence.encoder(points, packet, 1), state), network
    )
    flops = f'{text}; 2 per multiply-add'
    interval = f'{text}; frame and 20 packets, PyTorch on this CPU, one thread'
    return [
        _row(f'{name}: parameters', _one(count_parameters(network)), '', 'counted', PARAMETERS),
        _row(f'{name}: operations per frame interval', operations, 'FLOP', flops, FLOPS),
        _row(f'{name}: one frame interval', cycle_ms, 'ms', interval),
        _row(f'{name}: one packet', packet_ms, 'ms', f'{thread}; paper: RTX 4090', LATENCY_MS),
    ]


def our_rows(seconds: float) -> list[Row]:
    """Return size and speed of the shipped model, timed on a trial of a length [s]."""
    config = checked_config(read_model(find_model(DEFAULT_MODEL)))
    parameters, operations = _one(fger.count_parameters(config)), fger.operations_per_cycle(config)
    name, flops = NETWORKS[OURS].label, '2 per multiply-add'
    rows = [
        _row(f'{name}: parameters', parameters, '', 'counted', PARAMETERS),
        _row(f'{name}: operations per frame interval', _one(operations), 'FLOP', flops, FLOPS),
    ]
    for step, times in zip(('window', 'frame'), step_times_ms(seconds), strict=True):
        text = f'this CPU, one thread, {len(times)} {step}s'
        p50, p99 = (_one(each) for each in np.quantile(times, (0.5, 0.99)))
        title, paper = f'{name}: {step} step', LATENCY_MS if step == 'window' else None
        rows.append(_row(title, p50, 'ms', f'median; {text}', paper))
        rows.append(_row(f'{title}, 99th percentile', p99, 'ms', text))
    return rows


def _one(value: float) -> Value:
    return Value(float(value), 0.0, 1, 'count')


def step_times_ms(seconds: float) -> tuple[list[float], list[float]]:
    """Return the times of window steps, in real time, and of frame steps of the shipped model [ms].

    Frame steps run beside the window steps, as in the node, and are timed alone.

    Args:
        seconds: Length of the simulated trial [s].
    """
    content = read_model(find_model(DEFAULT_MODEL))
    warm_up(open_estimator(content))
    trial = SimulatedSource(TrialSpec(DEVICE_SEED, TRIAL_SEED, 'dynamic', seconds, PRESET)).load()
    paced = ForceEstimator(open_estimator(content), background_frames=True)
    alone = ForceEstimator(open_estimator(content))
    window_ms, frame_ms = [], []
    windows = list(windows_of(trial, paced.window_us))
    start_s = time.perf_counter() - 1e-6 * windows[0].end_us
    for window in windows:
        for image, middle_us in window.frames:
            paced.push_frame(image, middle_us)
        time.sleep(max(start_s + 1e-6 * window.end_us - time.perf_counter(), 0.0))
        called_s = time.perf_counter()
        if paced.push_events(window.events, window.end_us):
            window_ms.append(1e3 * (time.perf_counter() - called_s))
    paced.close()
    for image, middle_us in (frame for window in windows for frame in window.frames):
        called_s = time.perf_counter()
        alone.push_frame(image, middle_us)
        frame_ms.append(1e3 * (time.perf_counter() - called_s))
    return window_ms, frame_ms[0 if alone.reference is None else alone.reference.frames :]


def _timed(call: Callable[[], object], network: PaperNetwork) -> Value:
    """Return the duration of a call in evaluation mode on one thread [ms]."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    network.eval()
    with torch.no_grad():
        call()
        durations_s = timeit.repeat(call, number=1, repeat=REPETITIONS)
    torch.set_num_threads(threads)
    return Value.of((1e3 * each for each in durations_s), 'repetitions')
