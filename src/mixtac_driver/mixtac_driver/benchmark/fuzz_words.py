# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Words to torment the decoder with: random ones, and sound streams that were damaged."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_driver.identity import Geometry

    Words = NDArray[np.uint16]

EDGES = (2, 3, 4, 16, 17)
MAX_DAMAGES = 64


def _events(rng: np.random.Generator, geometry: Geometry) -> list[int]:
    """A row with columns, hardly ever outside the array."""
    row = int(rng.integers(0, geometry.dvs_rows + 2))
    columns = rng.integers(0, geometry.dvs_columns + 1, rng.integers(0, 12))
    return [0x1000 | row, *(columns | rng.choice([0x2000, 0x3000], len(columns)))]


def _frame(rng: np.random.Generator, geometry: Geometry) -> list[int]:
    """A frame of a small region, columns of both kinds one after the other or in turn."""
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


def sound_stream(rng: np.random.Generator, geometry: Geometry, parts: int) -> Words:
    """Return a stream as a camera sends it: everything stamped, the time wrapping."""
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


def crowded_words(rng: np.random.Generator, geometry: Geometry, size: int) -> Words:
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


def damaged(rng: np.random.Generator, sound: Words, other: Words) -> Words:
    """Return the stream with bits flipped, words lost, doubled and altered, and parts replaced."""
    words = sound.copy()
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
