# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Size and speed of the networks (paper, section III-B)."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np

from mixtac_lab.experiments.harness import Outcome, Row, Value
from mixtac_lab.experiments.sizes import PRESET
from mixtac_lab.experiments.training import FGER, LABELS
from mixtac_learning.train.config import OURS

if TYPE_CHECKING:
    from mixtac_lab.experiments.harness import Context


PARAMETERS, FLOPS, LATENCY_MS = 0.517e6, 2.0e9, 0.87
"""The paper's numbers; the latency on an RTX 4090."""
_PLACE = 'section III-B'
REPETITIONS = 10


def model(context: Context) -> Outcome:
    """Return parameters, operations and latency of both networks, on this machine.

    Raises:
        ModelError: The shipped model is missing.
    """
    bar = context.progress.add_task('size and latency', total=2)
    rows = _paper_rows()
    context.progress.advance(bar)
    rows += _our_rows(context.sizes.latency_seconds)
    context.progress.advance(bar)
    return Outcome(
        name='model',
        title='Size and speed of the network',
        paper='0.517 M parameters, 2.0 GFLOPs, 0.87 ms on an NVIDIA RTX 4090.',
        data=f'shipped small model; random weights of the paper network at 346 x 260; virtual'
        f' sensor, preset {PRESET}, in real time for the window step',
        rows=rows,
        deviations=(
            'Latency on this CPU, one thread, not on a GPU; other work on the machine adds to it.',
            "The paper's widths are not stated; those that reach both totals were taken.",
            (
                'The paper does not say what its latency spans; here the window step'
                ' decodes a packet'
                ' and gives a force, and the frame step runs beside it, 25 times a second.'
            ),
        ),
    )


def _paper_rows() -> list[Row]:
    from mixtac_learning.network import count_parameters
    from mixtac_learning.paper.config import PaperConfig
    from mixtac_learning.paper.networks import build, operations_per_cycle

    config = PaperConfig()
    network = build(config)
    name, text = LABELS[FGER], 'native resolution, 512 events per packet'
    exact = 'counted'
    return [
        Row(
            f'{name}: parameters',
            _one(count_parameters(network)),
            PARAMETERS,
            _PLACE,
            '',
            exact,
            False,
        ),
        Row(
            f'{name}: operations per frame interval',
            _one(operations_per_cycle(config)),
            FLOPS,
            _PLACE,
            'FLOP',
            f'{text}; 2 per multiply-add',
            False,
        ),
        Row(
            f'{name}: one frame interval',
            Value.of(_cycle_ms(network, config), 'repetitions'),
            None,
            '',
            'ms',
            f'{text}; frame and 20 packets, PyTorch on this CPU, one thread',
            False,
        ),
        Row(
            f'{name}: one packet',
            Value.of(_packet_ms(network, config), 'repetitions'),
            LATENCY_MS,
            _PLACE,
            'ms',
            f'{text}; PyTorch on this CPU, one thread; paper: RTX 4090',
            False,
        ),
    ]


def _our_rows(seconds: float) -> list[Row]:
    from mixtac_lab.bench.infer import measure

    found: dict[str, Any] = measure(None, seconds, PRESET)
    name = LABELS[OURS]
    text = 'this CPU, one thread; spread: median to 99th percentile'
    windows = int(found['windows'])
    return [
        Row(
            f'{name}: parameters',
            _one(found['parameters']),
            PARAMETERS,
            _PLACE,
            '',
            'counted',
            False,
        ),
        Row(
            f'{name}: operations per frame interval',
            _one(found['flops_per_cycle']),
            FLOPS,
            _PLACE,
            'FLOP',
            '2 per multiply-add',
            False,
        ),
        Row(
            f'{name}: window step',
            _median(found['step_ms'], windows),
            LATENCY_MS,
            _PLACE,
            'ms',
            text,
        ),
        Row(f'{name}: frame step', _median(found['frame_ms'], windows), None, '', 'ms', text),
    ]


def _one(value: float) -> Value:
    return Value(float(value), 0.0, 1, 'count')


def _median(quantiles: dict[str, float], count: int) -> Value:
    return Value(quantiles['p50'], quantiles['p99'] - quantiles['p50'], count, 'windows')


def _cycle_ms(network: Any, config: Any) -> list[float]:  # noqa: ANN401 - torch is loaded late
    from mixtac_learning.paper.networks import one_cycle

    batch = one_cycle(config)
    return _timed(lambda: network(batch, network.initial_state(1)), network)


def _packet_ms(network: Any, config: Any) -> list[float]:  # noqa: ANN401
    import torch

    points = torch.rand(config.events_per_packet, 4)
    packet = torch.zeros(config.events_per_packet, dtype=torch.int64)
    state = network.initial_state(1)
    recurrence = network.recurrence
    return _timed(lambda: recurrence.step(recurrence.encoder(points, packet, 1), state), network)


def _timed(call: Any, network: Any) -> list[float]:  # noqa: ANN401
    """Return the durations of a call in evaluation mode on one thread [ms]."""
    import torch

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
    return list(np.array(durations))
