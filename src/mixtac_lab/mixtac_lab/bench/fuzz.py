# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fuzz test of the decoder: random words and corrupted valid streams, with all output checked.

The words come in sessions, each with its own camera geometry. A session depends only on the seed
and its number, so a failing one can be repeated alone.
"""

from __future__ import annotations

import faulthandler
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Optional

import numpy as np
import typer
from numpy.typing import DTypeLike, NDArray
from rich.console import Console
from rich.progress import Progress

from mixtac_driver.davis346.model import Geometry
from mixtac_driver.decode.decoder import StreamDecoder
from mixtac_driver.errors import DriverError
from mixtac_events.readings import DecodedBatch, EdgeKind

Words = NDArray[np.uint16]


EDGES = (2, 3, 4, 16, 17)
MAX_DAMAGES = 64


def _events(rng: np.random.Generator, geometry: Geometry) -> list[int]:
    """Return a row with columns, rarely outside the array."""
    row = int(rng.integers(0, geometry.dvs_rows + 2))
    columns = rng.integers(0, geometry.dvs_columns + 1, rng.integers(0, 12))
    return [0x1000 | row, *(columns | rng.choice([0x2000, 0x3000], len(columns)))]


def _frame(rng: np.random.Generator, geometry: Geometry) -> list[int]:
    """Return a frame of a small region, with columns of both kinds in sequence or alternating."""
    aps = (geometry.aps_columns, geometry.aps_rows)
    x0, y0 = (int(rng.integers(0, n)) for n in (aps[::-1] if geometry.aps_inverted else aps))
    width, height = (int(n) for n in rng.integers(1, 40, 2))
    region = [w for v in (x0, y0, x0 + width - 1, y0 + height - 1) for w in (v >> 8, v & 0xFF)]
    words = [int(rng.integers(8, 10)), *(0x6000 | rng.integers(0, 1024, 3))]
    words += [(0x5100, 0x5200)[k % 2] | byte for k, byte in enumerate(region)]
    columns, rows = (height, width) if geometry.aps_inverted else (width, height)
    kinds = np.repeat([11, 12], columns) if rng.random() < 0.5 else np.tile([11, 12], columns)
    for kind in kinds:
        words += [int(kind), *(0x4000 | rng.integers(0, 1024, rows)), 13]
    return [*words, 14, 15, 10]


def _inertial(rng: np.random.Generator) -> list[int]:
    info = int(rng.integers(0, 256))
    size = 6 * bool(info & 0x80) + 6 * bool(info & 0x40) + 2 * bool(info & 0x20)
    return [5, 0x5300 | info, *(0x5000 | rng.integers(0, 256, size)), 7]


def valid_stream(rng: np.random.Generator, geometry: Geometry, parts: int) -> Words:
    """Return a stream as a camera sends it: all data with time stamps, and time wraps."""
    words: list[int] = []
    tick = 0
    for _ in range(parts):
        tick += int(rng.integers(0, 900))
        if tick > 0x7FFF:
            tick &= 0x7FFF
            words.append(0x7000 | int(rng.integers(1, 4)))
        words.append(0x8000 | tick)
        kind = rng.random()
        if kind < 0.8:
            words += _events(rng, geometry)
        elif kind < 0.9:
            words += _inertial(rng)
        elif kind < 0.96:
            words.append(int(rng.choice(EDGES)))
        elif kind < 0.999:
            words += _frame(rng, geometry)
        else:
            words.append(1)
            tick = 0
    return np.array(words, '<u2')


def random_words(rng: np.random.Generator, size: int) -> Words:
    """Return words of any value."""
    return np.frombuffer(rng.bytes(2 * size), '<u2')


def mostly_address_words(rng: np.random.Generator, geometry: Geometry, size: int) -> Words:
    """Return words that are mostly rows, columns and stamps, in any order."""
    words = random_words(rng, size)
    limits = np.full(16, 0xFFFF, np.uint16)
    limits[1] = 0x1000 | geometry.dvs_rows
    limits[2], limits[3] = 0x2000 | geometry.dvs_columns, 0x3000 | geometry.dvs_columns
    kinds = np.array([8, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 2, 3, 2, 3], np.uint16)[words >> 12]
    usual: Words = np.minimum(kinds << 12 | (words & 0x1FF), limits[kinds])
    rare = rng.integers(0, size, size // 200)
    usual[rare] = words[rare]
    return usual


def damaged(rng: np.random.Generator, valid: Words, other: Words) -> Words:
    """Return a stream with flipped bits, lost, doubled and changed words, and replaced parts."""
    words = valid.copy()
    places = rng.integers(0, len(words), rng.integers(1, MAX_DAMAGES))
    words[places] ^= (1 << rng.integers(0, 16, len(places))).astype('<u2')
    places = rng.integers(0, len(words), rng.integers(1, MAX_DAMAGES))
    words[places] = random_words(rng, len(places))
    words = np.delete(words, rng.integers(0, len(words), rng.integers(1, MAX_DAMAGES)))
    twice = np.ones(len(words), np.int64)
    twice[rng.integers(0, len(words), rng.integers(1, MAX_DAMAGES))] += 1
    words = np.repeat(words, twice)
    a, b = np.sort(rng.integers(0, len(words), 2))
    c, d = np.sort(rng.integers(0, len(other), 2))
    return np.concatenate((words[:a], other[c:d], words[b:]))


SESSION_WORDS = 1 << 23
BLOCK_WORDS = 1 << 17
VALID_PARTS = 3000
GUARD = 64
HANG_S = 120.0
EDGE_KINDS = [int(kind) for kind in EdgeKind]
OptionalInt = Optional[int]  # noqa: UP045  (typer evaluates this under Python 3.10)


class FuzzError(DriverError):
    """The decoder violated an invariant."""


def _require(holds: bool, what: str) -> None:
    if not holds:
        raise FuzzError(what)


class GuardedDecoder(StreamDecoder):
    """A decoder that notices when something is written outside its arrays.

    Args:
        geometry: Pixel arrays of the camera.
        capacity: Events per batch.
    """

    def __init__(self, geometry: Geometry, *, capacity: int) -> None:
        self._guarded: list[NDArray[np.uint8]] = []
        super().__init__(geometry, capacity=capacity, allocate=self._allocate)

    def _allocate(self, length: int, dtype: DTypeLike) -> NDArray[Any]:
        """Return a zeroed array with guard bytes on both sides."""
        size = length * np.dtype(dtype).itemsize
        room = np.full(size + 2 * GUARD, 0xA5, np.uint8)
        room[GUARD : GUARD + size] = 0
        self._guarded.append(room)
        return room[GUARD : GUARD + size].view(dtype)

    def intact(self) -> bool:
        """Return whether all guard bytes are unchanged."""
        ends = (end for room in self._guarded for end in (room[:GUARD], room[-GUARD:]))
        return all((end == 0xA5).all() for end in ends)


@dataclass(slots=True)
class Tally:
    """Checks and counts the output of the decoder in one session."""

    geometry: Geometry
    resets: int = 0
    time_us: int = 0
    events: int = 0
    frames: int = 0
    imu: int = 0
    edges: int = 0

    def take(self, batch: DecodedBatch) -> None:
        """Check one batch and count its contents.

        Raises:
            FuzzError: A position or a time is impossible.
        """
        _require(batch.resets in (self.resets, self.resets + 1), 'resets were skipped')
        if batch.resets > self.resets:
            self.resets, self.time_us = batch.resets, 0
        self._check_events(batch)
        for t, name in ((batch.imu.t, 'imu'), (batch.edges.t, 'edges')):
            _require(_in_order(t, self.time_us, batch.time_us), f'time of {name} goes back')
        _require(bool(np.isin(batch.edges.kind, EDGE_KINDS).all()), 'unknown edge')
        self._check_frames(batch)
        self.time_us = batch.time_us
        self.events += len(batch.events)
        self.frames += len(batch.frames)
        self.imu += len(batch.imu.t)
        self.edges += len(batch.edges.t)

    def _check_events(self, batch: DecodedBatch) -> None:
        events = batch.events
        _require(_in_order(events.t, self.time_us, batch.time_us), 'time of events goes back')
        if len(events):
            width, height = self.geometry.event_size
            inside = int(events.x.max()) < width and int(events.y.max()) < height
            _require(inside, 'event outside the array')
            polarity = events.polarity.view(np.uint8)
            _require(int(polarity.max()) <= 1, 'polarity is neither 0 nor 1')

    def _check_frames(self, batch: DecodedBatch) -> None:
        aps = (self.geometry.aps_rows, self.geometry.aps_columns)
        rows, columns = aps[::-1] if self.geometry.aps_inverted else aps
        for frame in batch.frames:
            height, width = frame.image.shape
            inside = frame.x + width <= columns and frame.y + height <= rows
            _require(inside and frame.x >= 0 and frame.y >= 0, 'frame outside the array')
            _require(int(frame.image.max()) <= 1023, 'pixel above 1023')
            times = (frame.frame_start_us, frame.frame_end_us, batch.time_us)
            _require(list(times) == sorted(times), 'times of a frame go back')


def _in_order(t: NDArray[np.int64], first: int, last: int) -> bool:
    if not len(t):
        return first <= last
    return bool(first <= t[0] and t[-1] <= last and (t[1:] >= t[:-1]).all())


def _geometry(rng: np.random.Generator) -> Geometry:
    dvs, aps, flip_x, flip_y = (bool(b) for b in rng.integers(0, 2, 4))
    sizes = [(260, 346) if inverted else (346, 260) for inverted in (dvs, aps)]
    return Geometry(*sizes[0], dvs, *sizes[1], aps, flip_x, flip_y)


def _blocks(rng: np.random.Generator, geometry: Geometry) -> Iterator[NDArray[np.uint16]]:
    """Yield blocks of all kinds of words, without end."""
    valid = [valid_stream(rng, geometry, VALID_PARTS) for _ in range(2)]
    while True:
        yield random_words(rng, BLOCK_WORDS)
        yield mostly_address_words(rng, geometry, BLOCK_WORDS)
        for _ in range(4):
            pieces = [damaged(rng, *valid[:: rng.choice([-1, 1])]) for _ in range(3)]
            yield np.concatenate(pieces)


def _push(
    rng: np.random.Generator, decoder: GuardedDecoder, tally: Tally, block: NDArray[np.uint16]
) -> int:
    """Push a block in transfers of random sizes, some cut within a word; return their bytes."""
    data = block.tobytes()
    limits = np.sort(rng.integers(0, len(data), rng.integers(1, 60))).tolist()
    pushed = 0
    for start, end in itertools.pairwise([0, *limits, len(data)]):
        lost = int(rng.integers(0, 9)) if rng.random() < 0.1 else 0
        transfer = data[start : max(end - lost, start)]
        for batch in decoder.push(transfer, short_packet=bool(rng.random() < 0.1)):
            tally.take(batch)
        pushed += len(transfer)
    return pushed


def _check_counters(decoder: GuardedDecoder, tally: Tally, pushed: int) -> None:
    counters = decoder.counters
    waiting = (pushed - counters.bytes_dropped) % 2
    _require(2 * counters.words + counters.bytes_dropped + waiting == pushed, 'bytes are missing')
    _require(counters.words_accounted == counters.words, 'words do not add up')
    for name in ('events', 'frames', 'imu', 'edges', 'resets'):
        _require(getattr(counters, name) == getattr(tally, name), f'{name} do not add up')
    _require(decoder.intact(), 'something was written outside the arrays')


def run_session(seed: int, number: int, words: int = SESSION_WORDS) -> Iterator[int]:
    """Run one session.

    Args:
        seed: Seed of all sessions.
        number: Number of this session.
        words: Words to push, rounded up to whole blocks.

    Yields:
        Number of words of each block.

    Raises:
        FuzzError: The decoder violated an invariant; the message holds seed and number.
    """
    rng = np.random.default_rng([seed, number])
    geometry = _geometry(rng)
    decoder = GuardedDecoder(geometry, capacity=int(rng.integers(1, 1 << rng.integers(8, 16))))
    tally = Tally(geometry)
    pushed = 0
    for block in _blocks(rng, geometry):
        faulthandler.dump_traceback_later(HANG_S, exit=True)
        try:
            pushed += _push(rng, decoder, tally, block)
            _check_counters(decoder, tally, pushed)
        except FuzzError as error:
            raise FuzzError(
                f'{error} after {pushed} bytes',
                remedy=f'repeat with --seed {seed} --only {number}',
            ) from error
        finally:
            faulthandler.cancel_dump_traceback_later()
        yield len(block)
        if pushed >= 2 * words:
            return


def fuzz(
    words: Annotated[float, typer.Option(min=1, help='Number of words.')] = 1e7,
    seed: Annotated[int, typer.Option(min=0, help='Random seed.')] = 0,
    only: Annotated[OptionalInt, typer.Option(min=0, help='Run only this session.')] = None,
) -> None:
    """Push random and damaged words through the decoder and check its output."""
    console = Console(markup=False)
    done = 0
    with Progress(console=console) as progress:
        task = progress.add_task('words', total=words)
        for number in itertools.count() if only is None else [only]:
            for size in run_session(seed, number):
                done += size
                progress.update(task, completed=done)
            if done >= words:
                break
    console.print(f'{done} words, seed {seed}: no errors')
