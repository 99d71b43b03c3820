# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How fast the decoder is on this machine, with the speed of memcpy beside it.

Run `python -m mixtac_driver.benchmark.decode_benchmark [--json FILE]`.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mixtac_driver.decoder import StreamDecoder
from mixtac_driver.identity import Geometry

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

ROWS_PER_STAMP = 10
TRANSFER_BYTES = 65536
REPEATS = 7


def event_stream(
    events_per_row: int, count: int, *, random: bool, seed: int = 1
) -> NDArray[np.uint16]:
    """Return a stream of about `count` events.

    Args:
        events_per_row: Events that share a row address.
        count: Events.
        random: True for a geometric spread of the events per row and of the stamps.
        seed: Of addresses and polarities.
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
    """Return a stream of full global-shutter frames."""
    rng = np.random.default_rng(seed)
    region = [0x5100, 0x5200, 0x5100, 0x5200, 0x5101, 0x5259, 0x5101, 0x5203]
    head = [8, 0x6000, 0x6000, 0x6000, *region]

    def columns(kind: int, low: int, high: int) -> NDArray[np.int64]:
        block = np.full((260, 348), 13)
        block[:, 0] = kind
        block[:, 1:-1] = 0x4000 | rng.integers(low, high, (260, 346))
        return block.ravel()

    reset, signal = columns(11, 700, 1000), columns(12, 100, 700)
    frame = np.concatenate((head, reset, [14, 15], signal, [10]))
    return np.tile(frame, frames).astype('<u2')


def best_seconds(run: Callable[[], None]) -> float:
    """Return the shortest of several runs [s]."""
    durations = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        run()
        durations.append(time.perf_counter() - start)
    return min(durations)


def decode_seconds(words: NDArray[np.uint16]) -> tuple[float, int, int]:
    """Return the time to decode a stream [s] and the events and frames found in one run."""
    decoder = StreamDecoder(Geometry())
    transfers = np.split(words, range(TRANSFER_BYTES // 2, len(words), TRANSFER_BYTES // 2))
    found = [0, 0]

    def run() -> None:
        found[:] = 0, 0
        for transfer in transfers:
            for batch in decoder.push(transfer):
                found[0] += len(batch.events)
                found[1] += len(batch.frames)

    return best_seconds(run), found[0], found[1]


def measure(count: int) -> dict[str, float]:
    """Return all figures: event rates [1/s], frame rate [1/s], memcpy [B/s].

    Args:
        count: Events per stream.
    """
    figures: dict[str, float] = {}
    for random in (False, True):
        for events_per_row in (1, 2, 8):
            words = event_stream(events_per_row, count, random=random)
            seconds, events, _ = decode_seconds(words)
            name = f'events_per_s_{events_per_row}_per_row{"_random" if random else ""}'
            figures[name] = events / seconds
            if not random:
                target = np.empty_like(words)
                copying = best_seconds(lambda w=words, t=target: np.copyto(t, w))  # type: ignore[misc]
                figures[f'memcpy_bytes_per_s_{events_per_row}_per_row'] = words.nbytes / copying
    seconds, _, frames = decode_seconds(frame_stream(20))
    figures['frames_per_s'] = frames / seconds
    return figures


def main(args: list[str] | None = None) -> int:
    """Measure, print and, if asked, write the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--events', type=int, default=4_000_000, help='events per stream')
    parser.add_argument('--json', type=Path, help='file to write the figures to')
    options = parser.parse_args(args)
    figures = measure(options.events)
    for name, value in figures.items():
        unit = 'frames/s' if name.startswith('frames') else 'million/s'
        print(f'{name:36s} {value if unit == "frames/s" else value / 1e6:10.0f} {unit}')
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=2) + '\n')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
