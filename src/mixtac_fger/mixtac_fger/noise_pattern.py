# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""The noise of an event camera as its fingerprint: events that are not of its pixels are found.

No two pixels have the same noise: leak, thresholds and light differ, and some pixels are hot. How
often a bin has an ON, or an OFF, event in 20 ms at rest is therefore a pattern p that belongs to
the sensor and to the way in which its events arrive. It does not move with the skin. Where events
are mirrored, shifted or inverted, or come from elsewhere, it is missing, in motion as at rest: long
before two frames can be compared with the events between them.

Whether a bin had an event in a stretch of 20 ms, s = 1 or 0, holds the pattern to the part

.. math:: x = \frac{\sum_b a_b s_b}{\sum_b a_b p_b}, \qquad
    \sigma_x^2 = \frac{\sum_b a_b^2 s_b}{(\sum_b a_b p_b)^2},

where a is p less its local mean: what is smooth, as the light is, looks the same in a mirror. x is
near 1, or near 0 where the pattern is missing, and :math:`(x_0 - x) / \sigma_x^2`, summed over
stretches and never below 0, is the logarithm of how much likelier the latter has become (Page's
test, 1954); its variance is at least the usual one. Tiles with many more events than at rest are
left out: they move.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_fger.pictures import TILE_COLUMNS, TILE_ROWS
from mixtac_fger.recent_events import Packed, bin_of, column_of, inverse_of, row_of

F32 = NDArray[np.float32]

RADIUS = 4
"""Bins to each side over which a local mean is taken."""
TILES = TILE_ROWS * TILE_COLUMNS
MOVING, STORMY, SPARE = 4.0, 3.0, 3.0
"""A tile moves where it has more events than at rest by so many standard deviations, or twice as
many; it is not calm where it has so many times as many; and events beside those."""
FEW, LEAST_STILL = 20, 0.3
"""Events of a stretch, and part of the pattern that does not move, below which nothing is said."""
MEMORY = 5.0
"""Stretches over which a tile is silent."""
SPAN = 2.0 * MEMORY - 1.0
"""What a mean with such a memory is the mean of."""
LEAST_RATE, RARE = 0.25, 5.0
"""Events over those at rest, without a fault 0.5 and more, and standard deviations by which there
have to be fewer, too: few events come and go."""
RARE_LINE = 3.0
"""The same for a row or a column, of which many have to be silent."""


@njit(cache=True, nogil=True, error_model='numpy')
def pattern_sums(
    events: Packed,
    size: int,
    tiles: NDArray[np.uint8],
    local: F32,
    there: NDArray[np.bool_],
    sums: NDArray[np.float64],
    counts: NDArray[np.float64],
) -> None:
    """Find how much of a pattern is in the events of a stretch, tile by tile.

    Args:
        events: int64 [n].
        size: Pixels of a bin along each axis.
        tiles: Tile of each bin, of `tiles_of`, uint8 [rows, columns].
        local: Pattern less its local mean, float32 [2, rows, columns] of bins; OFF first.
        there: Written: whether each bin had an event, bool, same shape.
        sums: Written: of `local` over the bins with an event, and of its square; float64
            [2, TILES].
        counts: Written: events of each tile, and of each row and column of pixels; float64
            [TILES + size * (rows + columns)].
    """
    there[:] = False
    sums[:] = 0.0
    counts[:] = 0.0
    _, rows, columns = local.shape
    inverse = inverse_of(size)
    first_column = TILES + size * rows
    for event in events:
        y, x = row_of(event), column_of(event)
        row, column, sign = bin_of(y, inverse), bin_of(x, inverse), event & 1
        if row < rows and column < columns:
            tile = tiles[row, column]
            counts[tile] += 1.0
            counts[TILES + y] += 1.0
            counts[first_column + x] += 1.0
            if not there[sign, row, column]:
                there[sign, row, column] = True
                value = np.float64(local[sign, row, column])
                sums[0, tile] += value
                sums[1, tile] += value * value


def tiles_of(rows: int, columns: int) -> NDArray[np.uint8]:
    """Return the tile of each bin, uint8 [rows, columns]."""
    row, column = np.arange(rows) * TILE_ROWS // rows, np.arange(columns) * TILE_COLUMNS // columns
    return (row[:, None] * TILE_COLUMNS + column).astype(np.uint8)


@njit(cache=True, nogil=True)
def least_number(usual: float, rare: float, share: float) -> float:
    """Return the number of events below which a sensor, or a part of it, is silent.

    Args:
        usual: Number at rest.
        rare: Standard deviations by which it is less.
        share: Part of the number at rest that it is less than.
    """
    return min(share * usual, usual - rare * np.sqrt(usual))  # type: ignore[no-any-return]


@njit(cache=True, nogil=True)
def weigh(
    sums: NDArray[np.float64],
    counts: NDArray[np.float64],
    held: NDArray[np.float64],
    usual: NDArray[np.float64],
) -> tuple[float, float, float, int]:
    """Add up the tiles that do not move, and count those that are calm.

    Args:
        sums: Of `pattern_sums`.
        counts: Of `pattern_sums`.
        held: Usual `sums`, of right events at rest.
        usual: Usual `counts`.

    Returns:
        The numerator of x, the sum under the variance of x, and the numerator that right events
        have: with higher thresholds there are fewer events, of the same pattern. Then how many
        tiles are calm.
    """
    calm = 0
    both = found = expected = usually = count = before = np.float64(0.0)
    for tile in range(TILES):
        calm += counts[tile] < STORMY * usual[tile] + SPARE
        more = min(usual[tile], MOVING * np.sqrt(usual[tile]))
        if counts[tile] < usual[tile] + more + SPARE:
            both += sums[0, tile]
            found += sums[1, tile]
            expected += held[0, tile]
            usually += held[1, tile]
            count += counts[tile]
            before += usual[tile]
    share = np.float64(0.0)
    # A handful of events has a pattern of its own; and where most of the skin moves, so do pixels
    # that show it by too few events.
    if min(count, before) >= FEW and expected >= LEAST_STILL * held[0].sum():
        share = min(count / before, np.float64(1.0))
    # Where bins of much weight happen to be empty, x is low, and no more certain for that.
    return both, max(found, usually * share), expected * share, calm


@njit(cache=True, nogil=True)
def count_silent(
    counts: NDArray[np.float64], usual: NDArray[np.float64], recent: NDArray[np.float64]
) -> tuple[int, int]:
    """Return how many tiles, and how many rows and columns of pixels, are silent.

    Args:
        counts: Of `pattern_sums`.
        usual: Usual `counts`.
        recent: `counts` of late, follows the stretch.
    """
    tiles = lines = 0
    for part in range(counts.shape[0]):
        recent[part] += (counts[part] - recent[part]) / MEMORY
        number, before = SPAN * recent[part], SPAN * usual[part]
        if part < TILES:
            tiles += number < least_number(before, RARE, LEAST_RATE)
        else:
            lines += number < least_number(before, RARE_LINE, LEAST_RATE)
    return tiles, lines


@njit(cache=True, nogil=True)
def unevenness(count: NDArray[np.float64], usual: NDArray[np.float64]) -> float:
    """Return how unevenly a stretch differs from rest: 1 where all noise has grown or fallen.

    Args:
        count: Events of each tile, float64 [TILES].
        usual: Their number at rest, same shape.

    Returns:
        Square of the difference to what is expected over its variance, the mean of the tiles.
    """
    grown, total = count.sum() / max(usual.sum(), np.float64(1.0)), np.float64(0.0)
    for tile in range(usual.shape[0]):
        expected = max(grown * usual[tile], np.float64(1.0))
        total += (count[tile] - expected) ** 2 / expected
    return total / usual.shape[0]  # type: ignore[no-any-return]


@njit(cache=True, nogil=True)
def add_seen(there: NDArray[np.bool_], share: float, pattern: F32) -> None:
    """Let a pattern follow the bins that had an event in a stretch.

    Args:
        there: Of `pattern_sums`.
        share: Weight of the stretch.
        pattern: Share of stretches in which each bin had an event, float32 of the same shape.
    """
    old, new = np.float32(1.0 - share), np.float32(share)
    before, now = pattern.reshape(-1), there.reshape(-1)
    for index in range(before.shape[0]):
        before[index] = before[index] * old + (new if now[index] else np.float32(0.0))


@njit(cache=True, nogil=True)
def less_local_mean(pattern: F32) -> F32:
    """Return a pattern less its mean over `RADIUS` bins to each side, the border repeated.

    Args:
        pattern: float32 [2, rows, columns].
    """
    planes, rows, columns = pattern.shape
    out, beside = np.empty_like(pattern), np.empty((rows, columns))
    area = (2 * RADIUS + 1) ** 2
    for plane in range(planes):
        for row in range(rows):
            for column in range(columns):
                total = np.float64(0.0)
                for near in range(column - RADIUS, column + RADIUS + 1):
                    total += pattern[plane, row, min(max(near, 0), columns - 1)]
                beside[row, column] = total
        for row in range(rows):
            for column in range(columns):
                total = np.float64(0.0)
                for near in range(row - RADIUS, row + RADIUS + 1):
                    total += beside[min(max(near, 0), rows - 1), column]
                out[plane, row, column] = pattern[plane, row, column] - total / area
    return out


class NoisePattern:
    """Learns the pattern of a sensor's noise, and says whether events still hold it.

    Args:
        width: Columns of the sensor [px].
        window_us: Length of a window [us].

    Attributes:
        missing: The latest events do not hold it.
        storm: All over the sensor there are many more events than at rest.
        silent: Parts of the sensor have hardly any events.
        windows: Windows of a stretch.
    """

    STRETCH_US: Final = 20_000
    """Length of a stretch [us]."""
    LEARNT: Final = 40
    """Stretches at rest after which the pattern is known, and between two of its updates."""
    JUDGED: Final = 8
    """Further ones after which it is known how much of it events hold."""
    KEPT: Final = 500
    """Stretches at rest of which it is the mean, once it is known one of four: it may change with
    the temperature."""
    LEAST: Final = 0.5
    """The x_0 of above."""
    LIMIT: Final = 15.0
    """Logarithm of the likelihood ratio from which on the pattern is missing, at 0 it is back. One
    stretch counts for no more than half of it."""
    CALM, STORMS = 5, 5
    """Calm tiles below which there is a storm, and stretches of that in a row that are no motion:
    of 84 trials without a fault, blows and vibrations among them, none has more than two."""
    SILENT_TILES, SILENT_LINES = 6, 44
    """Tiles, and rows and columns, from which on a part of the sensor is silent; in 129 trials
    without a fault 2 and 22 at most, both in vibrations."""
    STIRRED, FIRST = 2.0, 5
    """Unevenness over that at rest, and over 1, from which on something moves, and stretches from
    which on it is known: at rest of ten stretches one has 1.4 and one of hundreds 2, in slow motion
    2 to 5. Real noise may be less even than 1."""

    def __init__(self, width: int, window_us: int) -> None:
        self.windows = max(self.STRETCH_US // window_us, 1)
        self._width = width
        self.forget()

    def forget(self) -> None:
        """Forget the sensor."""
        self._pattern: F32 | None = None
        self._local: F32 | None = None
        self._sums, self._held = np.zeros((2, 2, TILES))
        self._rests = self._learnt = self._judged = 0
        self._recent: NDArray[np.float64] | None = None
        self._storms = 0
        self._doubt = self._uneven = 0.0
        self.missing = self.storm = self.silent = False

    @property
    def known(self) -> bool:
        """Whether events are held against it: the sensor has been at rest for some seconds."""
        return self._local is not None and self._judged >= self.JUDGED

    def confirm(self) -> None:
        """Learn the pattern anew where it is missing: the events have proved to be right."""
        if self.missing:
            self.forget()

    def judge(self, stretch: Packed) -> None:
        """Take the events of a stretch."""
        if self._local is None or not self.known:
            return
        self._add_up(stretch, self._local)
        if self._recent is None:
            self._recent = self._usual.copy()
        both, found, expected, calm = weigh(self._sums, self._counts, self._held, self._usual)
        tiles, lines = count_silent(self._counts, self._usual, self._recent)
        # What moves hides silent lines.
        least = self.SILENT_LINES // 2 if self.silent else self.SILENT_LINES
        self.silent = tiles >= self.SILENT_TILES or lines >= least
        self._storms = self._storms + 1 if calm < self.CALM else 0
        self.storm = self._storms >= self.STORMS
        if found > 0.0 and expected > 0.0:
            step = (self.LEAST * expected - both) * expected / found
            step = min(max(step, -self.LIMIT / 2.0), self.LIMIT / 2.0)
            self._doubt = min(max(self._doubt + step, 0.0), self.LIMIT)
        self.missing = self._doubt >= (1e-9 if self.missing else self.LIMIT)

    def learn(self, stretch: Packed, shape: tuple[int, int]) -> None:
        """Learn from a stretch in which nothing moved.

        Args:
            stretch: Its events.
            shape: Rows and columns of bins.
        """
        if self._pattern is None or self._pattern.shape[1:] != shape:
            self.forget()
            self._pattern = np.zeros((2, *shape), np.float32)
            self._there, self._tiles = np.zeros((2, *shape), np.bool_), tiles_of(*shape)
            size = self._width // shape[1]
            self._counts, self._usual = np.zeros((2, TILES + size * sum(shape)))
        self._rests += 1
        known = self._learnt >= 4 * self.LEARNT and self._rests % 4
        if known or self.missing or self._doubt > self.LIMIT / 4.0:
            return
        self._add_up(stretch, self._pattern if self._local is None else self._local)
        uneven = unevenness(self._counts[:TILES], self._usual[:TILES]) if self._learnt else 1.0
        if self._learnt >= self.FIRST and uneven > self.STIRRED * max(self._uneven, 1.0):
            return
        self._learnt += 1
        share = max(1.0 / self._learnt, 1.0 / self.KEPT)
        self._uneven += share * (uneven - self._uneven)
        self._usual += share * (self._counts - self._usual)
        add_seen(self._there, share, self._pattern)
        if self._local is not None:
            self._judged += 1
            share = max(1.0 / self._judged, 1.0 / self.KEPT)
            self._held += share * (self._sums - self._held)
        if self._learnt % self.LEARNT == 0:
            self._local = less_local_mean(self._pattern)

    def _add_up(self, events: Packed, local: F32) -> None:
        size, into = self._width // local.shape[2], (self._there, self._sums, self._counts)
        # Read in a row first: in the order of the events that takes three times as long.
        local.sum()
        pattern_sums(events, size, self._tiles, local, *into)


def warm_up() -> None:
    """Compile what a stretch needs, so that the first one is not late."""
    event, there = np.zeros(1, np.int64), np.zeros((2, 8, 8), np.bool_)
    pattern, sums, counts = (
        np.zeros((2, 8, 8), np.float32),
        np.zeros((2, TILES)),
        np.zeros(TILES + 64),
    )
    pattern_sums(event, 4, tiles_of(8, 8), pattern, there, sums, counts)
    unevenness(counts[:TILES], counts[:TILES])
    least_number(0.0, RARE, LEAST_RATE)
    weigh(sums, counts, sums, counts)
    count_silent(counts, counts, counts)
    add_seen(there, 0.5, pattern)
    less_local_mean(pattern)
