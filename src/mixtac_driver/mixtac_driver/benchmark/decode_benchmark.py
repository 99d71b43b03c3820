# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How fast the decoder is on this machine, with a plain memory copy of the same bytes beside it.

Streams are larger than the caches, so that decoder and copy both read from memory. The two take
turns many times, each through the whole stream, in pieces of about a millisecond. For each piece
the shortest time counts: so other load on the machine, which disturbs some pieces in every turn,
hardly shows.

Run `mixtac bench decode` or `python -m mixtac_driver.benchmark.decode_benchmark`.
"""

from __future__ import annotations

import json as json_module
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from mixtac_driver.benchmark.streams import (
    FRAME_COLUMNS,
    FRAME_ROWS,
    event_stream,
    frame_stream,
    repeated,
)
from mixtac_driver.decoder import StreamDecoder
from mixtac_driver.identity import Geometry

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)

EVENTS_PER_ROW = (1, 2, 8)
TRANSFER_BYTES = 256 << 10
"""Large enough that Python's share, about 5 us per transfer, hardly counts."""
EVENT_BYTES = 13
"""What an event takes in the decoder's arrays."""
FRAME_BYTES = 2 * FRAME_COLUMNS * FRAME_ROWS
SEED_EVENTS = 2_000_000
SEED_FRAMES = 4
MIN_TURNS = 5
STARTS = 4
PIECE_BYTES = 16 * TRANSFER_BYTES
START = (
    'import time; start = time.perf_counter()\n'
    'from mixtac_driver.decoder import StreamDecoder\n'
    'from mixtac_driver.identity import Geometry\n'
    'list(StreamDecoder(Geometry()).push(bytes(64)))\n'
    'print(time.perf_counter() - start)'
)


@dataclass(frozen=True, slots=True)
class Speed:
    """How fast one stream went.

    Attributes:
        per_s: Events or frames decoded per second.
        memcpy_ratio: Time to decode over time to copy the stream.
        output_memcpy_ratio: Time to decode over time to copy as many bytes as the output takes.
    """

    per_s: float
    memcpy_ratio: float
    output_memcpy_ratio: float


@dataclass(frozen=True, slots=True)
class DecodeReport:
    """Speeds of the decoder on one core.

    Attributes:
        fixed: By events per row: 1, 2, 8; the same in every row.
        random: By mean events per row; their number is geometrically distributed.
        frames: Full frames.
        memcpy_bytes_per_s: Of the fastest copy.
        start_s: Time [s] to import, construct and decode in a fresh process, compiled before.
        stream_bytes: Size of the streams.
        transfer_bytes: Size of the pieces in which the decoder gets them.
    """

    fixed: dict[int, Speed]
    random: dict[int, Speed]
    frames: Speed
    memcpy_bytes_per_s: float
    start_s: float
    stream_bytes: int
    transfer_bytes: int

    def as_dict(self) -> dict[str, object]:
        """Return the figures by their names in the JSON file."""
        return {
            **_figures(self.fixed),
            'frames_per_s': self.frames.per_s,
            'frames_memcpy_ratio': self.frames.memcpy_ratio,
            'random_rows': _figures(self.random),
            'memcpy_bytes_per_s': self.memcpy_bytes_per_s,
            'start_s': self.start_s,
            'stream_bytes': self.stream_bytes,
            'transfer_bytes': self.transfer_bytes,
        }


def _figures(speeds: dict[int, Speed]) -> dict[str, dict[str, float]]:
    rows = {str(k): asdict(speed) for k, speed in speeds.items()}
    names = ('memcpy_ratio', 'output_memcpy_ratio')
    figures = {'events_per_s': {k: row['per_s'] for k, row in rows.items()}}
    return figures | {name: {k: row[name] for k, row in rows.items()} for name in names}


def _shortest(jobs: list[list[Callable[[], None]]], seconds: float) -> list[float]:
    """Return the times [s] of jobs in pieces that take turns for a while.

    Args:
        jobs: The pieces of each job, of which the shortest times are added up.
        seconds: Time [s] that all turns take together, and at least MIN_TURNS.
    """
    best = [[np.inf] * len(pieces) for pieces in jobs]
    end = time.perf_counter() + seconds
    turns = 0
    while turns < MIN_TURNS or time.perf_counter() < end:
        for pieces, shortest in zip(jobs, best, strict=True):
            for k, piece in enumerate(pieces):
                start = time.perf_counter()
                piece()
                shortest[k] = min(shortest[k], time.perf_counter() - start)
        turns += 1
    return [sum(shortest) for shortest in best]


def _decode(decoder: StreamDecoder, words: NDArray[np.uint16]) -> None:
    for start in range(0, len(words), TRANSFER_BYTES // 2):
        for _ in decoder.push(words[start : start + TRANSFER_BYTES // 2], short_packet=False):
            pass


def _measure(words: NDArray[np.uint16], seconds: float) -> tuple[Speed, Speed, float]:
    """Return the speeds of events and of frames, and of the copy [B/s]."""
    decoder = StreamDecoder(Geometry(), capacity=TRANSFER_BYTES // 2)
    target = np.empty_like(words)
    _decode(decoder, words)
    counters = decoder.counters
    cuts = range(PIECE_BYTES // 2, len(words), PIECE_BYTES // 2)
    pieces, targets = np.split(words, cuts), np.split(target, cuts)
    decoding, copying = _shortest(
        [
            [partial(_decode, decoder, piece) for piece in pieces],
            [partial(np.copyto, *pair) for pair in zip(targets, pieces, strict=True)],
        ],
        seconds,
    )
    rate = words.nbytes / copying
    output = counters.events * EVENT_BYTES + counters.frames * FRAME_BYTES
    ratios = (decoding / copying, decoding * rate / output)
    events, frames = (Speed(n / decoding, *ratios) for n in (counters.events, counters.frames))
    return events, frames, rate


def start_seconds() -> float:
    """Return the time [s] to import, construct and decode in a fresh process.

    The first process only sees to it that everything is compiled; the fastest of the others counts.
    """
    times = [
        float(
            subprocess.run(
                [sys.executable, '-c', START], check=True, capture_output=True, text=True
            ).stdout
        )
        for _ in range(1 + STARTS)
    ]
    return min(times[1:])


def run_decode_benchmark(*, seconds: float = 1.5, stream_bytes: int = 128 << 20) -> DecodeReport:
    """Measure the decoder.

    Args:
        seconds: Time [s] for each of the seven streams.
        stream_bytes: Size of each stream; more than the processor's caches hold.
    """
    speeds: dict[bool, dict[int, Speed]] = {False: {}, True: {}}
    rates = []
    count = min(SEED_EVENTS, stream_bytes // 4)
    for random in (False, True):
        for k in EVENTS_PER_ROW:
            words = repeated(event_stream(k, count, random=random), stream_bytes)
            speeds[random][k], _, rate = _measure(words, seconds)
            rates.append(rate)
    _, frames, _ = _measure(repeated(frame_stream(SEED_FRAMES), stream_bytes), seconds)
    return DecodeReport(
        fixed=speeds[False],
        random=speeds[True],
        frames=frames,
        memcpy_bytes_per_s=max(rates),
        start_s=start_seconds(),
        stream_bytes=stream_bytes,
        transfer_bytes=TRANSFER_BYTES,
    )


def _print(console: Console, report: DecodeReport) -> None:
    table = Table(title='Decoder, one core', caption='copy: of the same bytes, memory to memory')
    for name in ('stream', 'speed', 'time over copy', 'over copy of output'):
        table.add_column(name, justify='left' if name == 'stream' else 'right')
    for title, speeds in (('events per row', report.fixed), ('on average', report.random)):
        for k, speed in speeds.items():
            table.add_row(
                f'{k} {title}',
                f'{speed.per_s / 1e6:.0f} Mev/s',
                f'{speed.memcpy_ratio:.1f}',
                f'{speed.output_memcpy_ratio:.1f}',
            )
    frames = report.frames
    table.add_row(
        'frames',
        f'{frames.per_s:.0f} frames/s',
        f'{frames.memcpy_ratio:.1f}',
        f'{frames.output_memcpy_ratio:.1f}',
    )
    console.print(table)
    console.print(f'memory copy {report.memcpy_bytes_per_s / 1e9:.1f} GB/s')
    console.print(f'start-up of the decoder, compiled before: {report.start_s:.2f} s')


def decode(
    json: Annotated[OptionalPath, typer.Option(help='Write the figures there as well.')] = None,
    seconds: Annotated[float, typer.Option(min=0, help='Time for each of seven streams.')] = 1.5,
    megabytes: Annotated[
        int, typer.Option(min=1, help='Size of each stream; more than the caches hold.')
    ] = 128,
) -> None:
    """Measure how fast events and frames are decoded, beside a plain copy of the same bytes."""
    report = run_decode_benchmark(seconds=seconds, stream_bytes=megabytes << 20)
    _print(Console(), report)
    if json is not None:
        json.write_text(json_module.dumps(report.as_dict(), indent=2) + '\n')


if __name__ == '__main__':
    typer.run(decode)
