# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Speed of the decoder on this machine, relative to a plain memory copy of the same bytes.

Streams are larger than the caches, so decoder and copy both read from memory. They alternate many
times, each over the whole stream, in pieces of about a millisecond. The shortest time of each
piece counts, which removes most of the influence of other load.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from mixtac.figures import make_table
from mixtac.options import JsonFile
from mixtac_core.events.readings import DecodedBatch
from mixtac_core.node.files import write_json
from mixtac_driver.davis346.model import Geometry
from mixtac_driver.decode.decoder import StreamDecoder

ROWS_PER_STAMP, SEED = 10, 1
FRAME_COLUMNS, FRAME_ROWS = 260, 346


def event_stream(events_per_row: int, count: int, *, random: bool) -> NDArray[np.uint16]:
    """Return a stream of about `count` events for the default geometry.

    Args:
        events_per_row: Events that share a row address.
        count: Events.
        random: True for geometrically distributed events per row and time stamps.
    """
    rng = np.random.default_rng(SEED)
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


def frame_stream(frames: int) -> NDArray[np.uint16]:
    """Return a stream of full global-shutter frames for the default geometry."""
    rng = np.random.default_rng(SEED)
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


EVENTS_PER_ROW = (1, 2, 8)
TRANSFER_BYTES = 256 << 10
"""Large enough that the share of Python, about 5 us per transfer, is negligible [B]."""
EVENT_BYTES = 13
"""Size of an event in the arrays of the decoder [B]."""
FRAME_BYTES = 2 * FRAME_COLUMNS * FRAME_ROWS
SEED_EVENTS = 2_000_000
SEED_FRAMES = 4
RATIOS = ('memcpy_ratio', 'output_memcpy_ratio')
"""Time to decode over the time to copy the stream, and over that to copy the size of the output."""
MIN_TURNS = 5
STARTS = 2
PIECE_BYTES = 4 * TRANSFER_BYTES
START = (
    'import time; start = time.perf_counter()\n'
    'from mixtac_driver.decode.decoder import StreamDecoder\n'
    'from mixtac_driver.davis346.model import Geometry\n'
    'list(StreamDecoder(Geometry()).push(bytes(64)))\n'
    'print(time.perf_counter() - start)'
)


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


def _batches(decoder: StreamDecoder, words: NDArray[np.uint16]) -> Iterator[DecodedBatch]:
    for start in range(0, len(words), TRANSFER_BYTES // 2):
        yield from decoder.push(words[start : start + TRANSFER_BYTES // 2])


def _decode(decoder: StreamDecoder, words: NDArray[np.uint16]) -> None:
    for _ in _batches(decoder, words):
        pass


def _measure(words: NDArray[np.uint16], seconds: float) -> tuple[float, tuple[float, float], float]:
    """Return events or frames decoded per second, `RATIOS`, and the speed of the copy [B/s]."""
    decoder = StreamDecoder(Geometry(), capacity=TRANSFER_BYTES // 2)
    target = np.empty_like(words)
    sizes = [(len(each.events), len(each.frames)) for each in _batches(decoder, words)]
    events, frames = np.sum(sizes, axis=0)
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
    output = events * EVENT_BYTES + frames * FRAME_BYTES
    ratios = (decoding / copying, float(decoding * rate / output))
    return float(events or frames) / decoding, ratios, rate


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


def measure(seconds: float, stream_bytes: int) -> dict[str, Any]:
    """Measure the decoder on one core and return the figures for JSON.

    Args:
        seconds: Time for each of the seven streams [s].
        stream_bytes: Size of each stream [B]; more than the caches of the processor.

    Returns:
        Figures by events per row: 1, 2, 8, the same in every row and, in `random_rows`, on average;
        those of full frames; `memcpy_bytes_per_s` of the fastest copy; `start_s`, see
        `start_seconds`; sizes of the streams and of the pieces in which the decoder gets them.
    """
    figures: dict[str, Any] = {}
    rates = []
    count = min(SEED_EVENTS, stream_bytes // 4)
    for random, place in ((False, figures), (True, figures.setdefault('random_rows', {}))):
        for k in EVENTS_PER_ROW:
            words = repeated(event_stream(k, count, random=random), stream_bytes)
            per_s, ratios, rate = _measure(words, seconds)
            rates.append(rate)
            for name, value in zip(('events_per_s', *RATIOS), (per_s, *ratios), strict=True):
                place.setdefault(name, {})[str(k)] = value
    per_s, ratios, _ = _measure(repeated(frame_stream(SEED_FRAMES), stream_bytes), seconds)
    return figures | {
        'frames_per_s': per_s,
        **{f'frames_{name}': value for name, value in zip(RATIOS, ratios, strict=True)},
        'memcpy_bytes_per_s': max(rates),
        'start_s': start_seconds(),
        'stream_bytes': stream_bytes,
        'transfer_bytes': TRANSFER_BYTES,
    }


def _table(figures: dict[str, Any]) -> Table:
    rows = [
        (
            f'{k} {title}',
            f'{rate / 1e6:.0f} Mev/s',
            *(f'{each[name][k]:.1f}' for name in RATIOS),
        )
        for title, each in (('events per row', figures), ('on average', figures['random_rows']))
        for k, rate in each['events_per_s'].items()
    ]
    frames = (f'{figures[f"frames_{name}"]:.1f}' for name in RATIOS)
    rows.append(('frames', f'{figures["frames_per_s"]:.0f} frames/s', *frames))
    headings = ('stream', 'speed', 'time over copy', 'over copy of output')
    return make_table('Decoder, one core (copy: the same bytes in memory)', headings, rows)


def decode(
    json: JsonFile = None,
    seconds: Annotated[
        float, typer.Option(min=0, help='Time for each of seven streams (s).')
    ] = 1.5,
    megabytes: Annotated[
        int, typer.Option(min=1, help='Size of each stream (MiB); more than the caches hold.')
    ] = 128,
) -> None:
    """Measure the decoding speed of events and frames, relative to a copy of the same bytes."""
    figures = measure(seconds, megabytes << 20)
    console = Console(markup=False)
    console.print(_table(figures))
    console.print(f'memory copy {figures["memcpy_bytes_per_s"] / 1e9:.1f} GB/s')
    console.print(f'start-up of the decoder, compiled before: {figures["start_s"]:.2f} s')
    write_json(json, figures)


if __name__ == '__main__':
    typer.run(decode)
