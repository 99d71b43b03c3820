# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Speed of the decoder on this machine, relative to a plain memory copy of the same bytes.

Streams are larger than the caches, so decoder and copy both read from memory. They alternate many
times, each over the whole stream, in pieces of about a millisecond. The shortest time of each
piece counts, which removes most of the influence of other load.

Run `mixtac bench decode` or `python -m mixtac_lab.bench.decode`.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Optional

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from mixtac_driver.davis346.model import Geometry
from mixtac_driver.decode.decoder import StreamDecoder
from mixtac_node.files import write_json

ROWS_PER_STAMP = 10
FRAME_COLUMNS, FRAME_ROWS = 260, 346


def event_stream(
    events_per_row: int, count: int, *, random: bool, seed: int = 1
) -> NDArray[np.uint16]:
    """Return a stream of about `count` events for the default geometry.

    Args:
        events_per_row: Events that share a row address.
        count: Events.
        random: True for geometrically distributed events per row and time stamps.
        seed: Seed of addresses and polarities.
    """
    rng = np.random.default_rng(seed)
    rows = count // events_per_row
    lengths = np.full(rows, events_per_row)
    stamped = np.arange(rows) % ROWS_PER_STAMP == 0
    if random:
        lengths = rng.geometric(1 / events_per_row, rows)
        stamped = rng.random(rows) < 1 / ROWS_PER_STAMP
        stamped[0] = True
    ticks = np.cumsum(stamped)
    wrapped = stamped & (ticks % 0x8000 == 0)
    sizes = lengths + 1 + stamped
    starts = np.cumsum(sizes) - sizes
    total = int(sizes.sum())
    words = rng.integers(0, 260, total) | np.where(rng.random(total) < 0.5, 0x2000, 0x3000)
    words[starts[stamped]] = 0x8000 | (ticks[stamped] & 0x7FFF)
    words[starts[wrapped]] = 0x7001
    words[starts + stamped] = 0x1000 | rng.integers(0, 346, rows)
    return words.astype('<u2')


def frame_stream(frames: int, seed: int = 1) -> NDArray[np.uint16]:
    """Return a stream of full global-shutter frames for the default geometry."""
    rng = np.random.default_rng(seed)
    region = [0x5100, 0x5200, 0x5100, 0x5200, 0x5101, 0x5259, 0x5101, 0x5203]
    head = [8, 0x6000, 0x6000, 0x6000, *region]

    def columns(kind: int, low: int, high: int) -> NDArray[np.int64]:
        block = np.full((FRAME_COLUMNS, FRAME_ROWS + 2), 13)
        block[:, 0] = kind
        block[:, 1:-1] = 0x4000 | rng.integers(low, high, (FRAME_COLUMNS, FRAME_ROWS))
        return block.ravel()

    reset, signal = columns(11, 700, 1000), columns(12, 100, 700)
    frame = np.concatenate((head, reset, [14, 15], signal, [10]))
    return np.tile(frame, frames).astype('<u2')


def repeated(words: NDArray[np.uint16], size: int) -> NDArray[np.uint16]:
    """Return a stream repeated to about a size, with a time wrap before each repetition.

    Args:
        words: The stream.
        size: Size [B]; the result holds at least one whole stream.
    """
    once = np.concatenate((np.array([0x7001], '<u2'), words))
    return np.tile(once, max(round(size / once.nbytes), 1))


OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)
EVENTS_PER_ROW = (1, 2, 8)
TRANSFER_BYTES = 256 << 10
"""Large enough that the share of Python, about 5 us per transfer, is negligible [B]."""
EVENT_BYTES = 13
"""Size of an event in the arrays of the decoder [B]."""
FRAME_BYTES = 2 * FRAME_COLUMNS * FRAME_ROWS
SEED_EVENTS = 2_000_000
SEED_FRAMES = 4
MIN_TURNS = 5
STARTS = 4
PIECE_BYTES = 16 * TRANSFER_BYTES
START = (
    'import time; start = time.perf_counter()\n'
    'from mixtac_driver.decode.decoder import StreamDecoder\n'
    'from mixtac_driver.davis346.model import Geometry\n'
    'list(StreamDecoder(Geometry()).push(bytes(64)))\n'
    'print(time.perf_counter() - start)'
)


@dataclass(frozen=True, slots=True)
class Speed:
    """Decoding speed of one stream.

    Attributes:
        per_s: Events or frames decoded per second.
        memcpy_ratio: Ratio of the time to decode to the time to copy the stream.
        output_memcpy_ratio: Ratio of the time to decode to the time to copy the size of the output.
    """

    per_s: float
    memcpy_ratio: float
    output_memcpy_ratio: float


@dataclass(frozen=True, slots=True)
class DecodeReport:
    """Speeds of the decoder on one core.

    Attributes:
        fixed: Speeds by events per row: 1, 2, 8; the same in every row.
        random: Speeds by mean events per row, geometrically distributed.
        frames: Speed of full frames.
        memcpy_bytes_per_s: Speed of the fastest copy.
        start_s: Time to import, construct and decode in a new process, compiled before [s].
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
        """Return the figures for JSON."""
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
    """Return the sums of the shortest times of the pieces of jobs that alternate [s].

    Args:
        jobs: Pieces of each job.
        seconds: Time of all turns together [s]; there are at least MIN_TURNS.
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
    """Return the time to import, construct and decode in a new process [s].

    The first process only compiles; the fastest of the others counts.
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
        seconds: Time for each of the seven streams [s].
        stream_bytes: Size of each stream [B]; more than the caches of the processor.
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
    json: Annotated[
        OptionalPath, typer.Option(help='Also write the results to this JSON file.')
    ] = None,
    seconds: Annotated[
        float, typer.Option(min=0, help='Time for each of seven streams [s].')
    ] = 1.5,
    megabytes: Annotated[
        int, typer.Option(min=1, help='Size of each stream [MiB]; more than the caches hold.')
    ] = 128,
) -> None:
    """Measure the decoding speed of events and frames, relative to a copy of the same bytes."""
    report = run_decode_benchmark(seconds=seconds, stream_bytes=megabytes << 20)
    _print(Console(), report)
    if json is not None:
        write_json(json, report.as_dict())


if __name__ == '__main__':
    typer.run(decode)
