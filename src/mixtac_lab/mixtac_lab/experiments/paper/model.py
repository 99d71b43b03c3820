# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Size and speed of the networks (paper, section III-B)."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import torch

from mixtac_fger.weights import DEFAULT_MODEL
from mixtac_lab.experiments.harness import Context, experiment
from mixtac_lab.experiments.report import Outcome, Row, Value, texts
from mixtac_lab.experiments.sizes import FGER, PRESET
from mixtac_lab.experiments.speed import measure
from mixtac_lab.experiments.training import MODELS
from mixtac_learning.network import count_parameters
from mixtac_learning.paper.config import PaperConfig
from mixtac_learning.paper.networks import PaperNetwork, build, one_cycle, operations_per_cycle
from mixtac_learning.train.config import OURS

PARAMETERS, FLOPS, LATENCY_MS = 0.517e6, 2.0e9, 0.87
"""The paper's numbers; the latency on an RTX 4090."""
_PLACE = 'section III-B'
REPETITIONS = 10


@experiment
def model(context: Context) -> Outcome:
    """Parameters, operations and latency of the networks."""
    bar = context.progress.add_task('size and latency', total=2)
    rows = _paper_rows()
    context.progress.advance(bar)
    rows += _our_rows(context.sizes.latency_seconds)
    context.progress.advance(bar)
    return Outcome(
        data=f'shipped small model; random weights of the paper network at 346 x 260; virtual'
        f' sensor, preset {PRESET}, in real time for the window step',
        rows=rows,
        **texts('model'),
    )


def _row(name: str, value: Value, unit: str, text: str, paper: float | None = None) -> Row:
    place = '' if paper is None else _PLACE
    return Row(name, value, paper, place, unit, text, simulated=False)


def _paper_rows() -> list[Row]:
    config = PaperConfig()
    network = build(config)
    name, text = MODELS[FGER].label, 'native resolution, 512 events per packet'
    thread = f'{text}; PyTorch on this CPU, one thread'
    operations = _one(operations_per_cycle(config))
    batch = one_cycle(config)
    cycles = _timed(lambda: network(batch, network.initial_state(1)), network)
    cycle_ms = Value.of(cycles, 'repetitions')
    packet_ms = Value.of(_packet_ms(network, config), 'repetitions')
    flops = f'{text}; 2 per multiply-add'
    interval = f'{text}; frame and 20 packets, PyTorch on this CPU, one thread'
    return [
        _row(f'{name}: parameters', _one(count_parameters(network)), '', 'counted', PARAMETERS),
        _row(f'{name}: operations per frame interval', operations, 'FLOP', flops, FLOPS),
        _row(f'{name}: one frame interval', cycle_ms, 'ms', interval),
        _row(f'{name}: one packet', packet_ms, 'ms', f'{thread}; paper: RTX 4090', LATENCY_MS),
    ]


def _our_rows(seconds: float) -> list[Row]:
    found: dict[str, Any] = measure(DEFAULT_MODEL, seconds, PRESET)
    name = MODELS[OURS].label
    operations = _one(found['flops_per_cycle'])
    flops = '2 per multiply-add'
    return [
        _row(f'{name}: parameters', _one(found['parameters']), '', 'counted', PARAMETERS),
        _row(f'{name}: operations per frame interval', operations, 'FLOP', flops, FLOPS),
        *_step_rows(
            f'{name}: window step', found['step_ms'], f'{found["windows"]} windows', LATENCY_MS
        ),
        *_step_rows(f'{name}: frame step', found['frame_ms'], f'{found["frames"]} frames', None),
    ]


def _one(value: float) -> Value:
    return Value(float(value), 0.0, 1, 'count')


def _step_rows(name: str, ms: dict[str, float], counted: str, paper: float | None) -> list[Row]:
    place = '' if paper is None else _PLACE
    text = f'this CPU, one thread, {counted}'
    return [
        Row(name, _one(ms['p50']), paper, place, 'ms', f'median; {text}'),
        Row(f'{name}, 99th percentile', _one(ms['p99']), None, '', 'ms', text),
    ]


def _packet_ms(network: PaperNetwork, config: PaperConfig) -> list[float]:
    points = torch.rand(config.events_per_packet, 4)
    packet = torch.zeros(config.events_per_packet, dtype=torch.int64)
    state = network.initial_state(1)
    recurrence: Any = network.recurrence
    return _timed(lambda: recurrence.step(recurrence.encoder(points, packet, 1), state), network)


def _timed(call: Callable[[], object], network: PaperNetwork) -> list[float]:
    """Return the durations of a call in evaluation mode on one thread [ms]."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    network.eval()
    durations = []
    try:
        with torch.no_grad():
            call()
            for _ in range(REPETITIONS):
                start = time.perf_counter()
                call()
                durations.append(1e3 * (time.perf_counter() - start))
    finally:
        torch.set_num_threads(threads)
    return durations
