# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The loops of the DVS pixels, tile by tile.

All values of a tile lie side by side in one array (``values[tile, row, pixel]``), so the compiler
knows that no row overlaps another and vectorises the loops, and a tile is one stretch of memory.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from mixtac_sim.array_geometry import TILE, TILES

if TYPE_CHECKING:
    from numpy.typing import NDArray

FLOOR, GAIN, LIGHT, LOG, FOLLOW, DIFFERENCE, ON, OFF, LEAK, BEFORE, EARLIER, SPARE = range(12)
"""Rows of a tile: light without beads and what beads add [lx], light [lx], its logarithm, what the
pixel has followed of it, that less its value at the last event plus leak, thresholds, rise by leak
[1/s]; logarithm and difference at the start of the step, and a row for half-made values."""
ROWS = 12
"""Number of rows."""

SETTLED = np.float32(1e-3)
"""Distance from the light's logarithm at which a pixel counts as settled."""
NEVER = 1 << 62
"""A time that does not come [ns]."""
_LN2 = np.float32(0.6931471805599453)
_PER_ONE = np.float32(1.0 / 65536.0)
_F = np.float32


class PixelState(NamedTuple):
    """State of the pixels.

    Attributes:
        values: Rows of each tile [tiles, 12, 64], float32.
        bits: The same memory as int32.
        ready_ns: When a pixel sees again after an event [padded pixels] [ns], int64.
        last_ns: Until when a tile is up to date [tiles] [ns], int64.
        due_ns: When a skipped tile's first leak event comes [tiles] [ns], int64.
        active: Whether a tile has not settled [tiles], uint8.
    """

    values: NDArray[np.float32]
    bits: NDArray[np.int32]
    ready_ns: NDArray[np.int64]
    last_ns: NDArray[np.int64]
    due_ns: NDArray[np.int64]
    active: NDArray[np.uint8]


class Corners(NamedTuple):
    """Bandwidth and blind time of the pixels.

    Attributes:
        source_hz: Corner of the source follower [Hz].
        hz_per_lux: Corner of the photoreceptor per light [Hz/lx].
        refractory_ns: Blind time after an event [ns].
    """

    source_hz: float
    hz_per_lux: float
    refractory_ns: int


class Ripple(NamedTuple):
    """A small ripple of the lamp.

    Attributes:
        depth: Its peak over the mean, less 1; 0 for none.
        hz: Its frequency [Hz].
        phase: Its phase at time 0 [rad].
        now_ns: End of the step [ns].
    """

    depth: float
    hz: float
    phase: float
    now_ns: int


class Crossings(NamedTuple):
    """Where threshold crossings are collected.

    Attributes:
        keys: Packed as in ``readout``; times count from the block's start.
        tally: Number of keys, and number of crossings that did not fit [2], int64.
    """

    keys: NDArray[np.int64]
    tally: NDArray[np.int64]


@njit(cache=True, nogil=True, error_model='numpy')
def relight(values: NDArray[np.float32], bits: NDArray[np.int32], cover: NDArray[np.int32]) -> None:
    """Write light and logarithm of one tile under a cover.

    Thick cover hides what is behind it, nearly as exp(-s) would; the logarithm is exact to 2e-6.
    """
    for j in range(TILE):
        s = _F(cover[j]) * _PER_ONE
        through = _F(1.0) / (_F(1.0) + s * (_F(1.0) + s * (_F(0.5) + s * _F(1.0 / 6.0))))
        values[LIGHT, j] = values[FLOOR, j] + values[GAIN, j] * (_F(1.0) - through)
    for j in range(TILE):
        bits[SPARE, j] = (bits[LIGHT, j] & 0x7FFFFF) | 0x3F800000
    for j in range(TILE):
        z = (values[SPARE, j] - _F(1.0)) / (values[SPARE, j] + _F(1.0))
        q = z * z
        series = _F(1 / 7) + q * (_F(1 / 9) + q * _F(1 / 11))
        series = _F(1.0) + q * (_F(1 / 3) + q * (_F(1 / 5) + q * series))
        values[SPARE, j] = _F(2.0) * z * series
    for j in range(TILE):
        exponent = _F((bits[LIGHT, j] >> 23) - 127)
        values[LOG, j] = exponent * _LN2 + values[SPARE, j]


@njit(cache=True, nogil=True, error_model='numpy')
def _follow(
    values: NDArray[np.float32], corners: Corners, step_s: float, glow: tuple[float, float]
) -> tuple[int, int]:
    """Advance low-pass and difference of a tile; return whether a pixel fires, whether one moves.

    The lamp's flicker, as a logarithm at start and end of the step, adds to that of the scene.

    The factor exp(-x) of a step is taken as 1 / (1 + x + x^2/2 + x^3/6 + x^4/24), which is within
    1 % while the pixel still remembers anything and goes to zero as it should.
    """
    source, per_lux = _F(corners.source_hz), _F(corners.hz_per_lux)
    phase, step = _F(2.0 * np.pi * step_s), _F(step_s)
    first, last = _F(glow[0]), _F(glow[1])
    fires, moves = np.int32(0), np.int32(0)
    for j in range(TILE):
        photo = per_lux * values[LIGHT, j]
        x = max(phase * photo * source / (photo + source), _F(1e-3))
        kept = _F(1.0) / (
            _F(1.0) + x * (_F(1.0) + x * (_F(0.5) + x * (_F(1 / 6) + x * _F(1 / 24))))
        )
        now, before = values[LOG, j] + last, values[BEFORE, j] + first
        rise = now - before
        value = kept * values[FOLLOW, j] + (_F(1.0) - kept) * before
        value += rise * (_F(1.0) - (_F(1.0) - kept) / x)
        changed = values[EARLIER, j] + (value - values[FOLLOW, j]) + values[LEAK, j] * step
        values[FOLLOW, j] = value
        values[DIFFERENCE, j] = changed
        fires |= np.int32(changed > values[ON, j]) | np.int32(changed < -values[OFF, j])
        moves |= np.int32(abs(now - value) > SETTLED)
    return int(fires), int(moves)


@njit(cache=True, nogil=True, error_model='numpy')
def _ripple(values: NDArray[np.float32], corners: Corners, ripple: Ripple, last_ns: int) -> int:
    """Add the steady response to a small ripple since a tile's last step; return whether one fires.

    A first-order pixel of corner c answers sin(wt) with [sin(wt) - q cos(wt)] / (1 + q^2), q = f/c.
    """
    source, per_lux = _F(corners.source_hz), _F(corners.hz_per_lux)
    turn = 2.0 * np.pi * ripple.hz * 1e-9
    first = turn * last_ns + ripple.phase
    last = turn * ripple.now_ns + ripple.phase
    sines = _F(np.sin(last) - np.sin(first))
    cosines = _F(np.cos(last) - np.cos(first))
    depth, frequency = _F(ripple.depth), _F(ripple.hz)
    fires = np.int32(0)
    for j in range(TILE):
        q = frequency * (_F(1.0) / source + _F(1.0) / (per_lux * values[LIGHT, j]))
        values[DIFFERENCE, j] += depth * (sines - q * cosines) / (_F(1.0) + q * q)
        changed = values[DIFFERENCE, j]
        fires |= np.int32(changed > values[ON, j]) | np.int32(changed < -values[OFF, j])
    return int(fires)


@njit(cache=True, nogil=True, error_model='numpy')
def _fire(
    state: PixelState,
    tile: int,
    j: int,
    start_ns: int,
    end_ns: int,
    block_ns: int,
    refractory_ns: int,
    crossings: Crossings,
) -> None:
    """Find the events of one pixel whose difference moved on a line over the step."""
    values, pixel = state.values[tile], tile * TILE + j
    span = float(end_ns - start_ns)
    since = max(float(state.ready_ns[pixel] - start_ns), 0.0)
    if since >= span:
        return
    on, off = float(values[ON, j]), float(values[OFF, j])
    slope = (float(values[DIFFERENCE, j]) - float(values[EARLIER, j])) / span
    value = float(values[EARLIER, j]) + slope * since
    while True:
        rising = value >= on or (value > -off and slope > 0.0)
        if value >= on or value <= -off:
            ahead = 0.0
        elif slope == 0.0:
            break
        else:
            ahead = ((on if rising else -off) - value) / slope
        if since + ahead > span:
            break
        since += ahead
        _note(crossings, start_ns - block_ns + int(since), pixel, rising)
        since += refractory_ns
        value = 0.0
        state.ready_ns[pixel] = start_ns + int(since)
        if since >= span:
            values[DIFFERENCE, j] = 0.0
            return
    values[DIFFERENCE, j] = value + slope * (span - since)


@njit(cache=True, nogil=True, error_model='numpy')
def _note(crossings: Crossings, at_ns: int, pixel: int, rising: bool) -> None:
    """Collect one crossing."""
    tally = crossings.tally
    if tally[0] < crossings.keys.size:
        crossings.keys[tally[0]] = (at_ns << 18) | (pixel << 1) | (1 if rising else 0)
        tally[0] += 1
    else:
        tally[1] += 1


@njit(cache=True, nogil=True, error_model='numpy')
def _due(values: NDArray[np.float32], end_ns: int) -> int:
    """Return when the first of a tile's pixels leaks over its threshold [ns]."""
    soonest = 1e9
    for j in range(TILE):
        if values[LEAK, j] > 0.0:
            away = float(values[ON, j] - values[DIFFERENCE, j])
            soonest = min(soonest, away / float(values[LEAK, j]))
    if soonest >= 1e9:
        return NEVER
    return end_ns + int(max(soonest, 0.0) * 1e9)


@njit(cache=True, nogil=True, error_model='numpy')
def blend(
    values: NDArray[np.float32],
    floors: NDArray[np.float32],
    gains: NDArray[np.float32],
    tiles: NDArray[np.int64],
    place: float,
) -> None:
    """Write light and gain of some tiles between two of a series of scenes [scene, tile, 64]."""
    low = min(int(place), floors.shape[0] - 2)
    part = _F(place - low)
    for tile in tiles:
        for j in range(TILE):
            floor, gain = floors[low, tile, j], gains[low, tile, j]
            values[tile, FLOOR, j] = floor + part * (floors[low + 1, tile, j] - floor)
            values[tile, GAIN, j] = gain + part * (gains[low + 1, tile, j] - gain)


@njit(cache=True, nogil=True, error_model='numpy')
def develop(
    state: PixelState,
    cover: NDArray[np.int32],
    dirty: NDArray[np.uint8],
    corners: Corners,
    glow: tuple[float, float],
    flickers: bool,
    ripple: Ripple,
    start_ns: int,
    end_ns: int,
    block_ns: int,
    crossings: Crossings,
) -> None:
    """Advance all pixels over one step; see ``Dvs.step``."""
    step_s = 1e-9 * (end_ns - start_ns)
    for tile in range(TILES):
        if not (flickers or dirty[tile] or state.active[tile] or state.due_ns[tile] <= end_ns):
            continue
        values = state.values[tile]
        idle_s = _F(1e-9 * (start_ns - state.last_ns[tile]))
        for j in range(TILE):
            values[EARLIER, j] = values[DIFFERENCE, j] + values[LEAK, j] * idle_s
            values[BEFORE, j] = values[LOG, j]
        if dirty[tile]:
            relight(values, state.bits[tile], cover[tile * TILE : (tile + 1) * TILE])
            dirty[tile] = 0
        fires, moves = _follow(values, corners, step_s, glow)
        if ripple.depth > 0.0:
            fires = _ripple(values, corners, ripple, state.last_ns[tile])
        if fires:
            for j in range(TILE):
                difference = values[DIFFERENCE, j]
                if difference > values[ON, j] or difference < -values[OFF, j]:
                    _fire(
                        state, tile, j, start_ns, end_ns, block_ns, corners.refractory_ns, crossings
                    )
        state.last_ns[tile] = end_ns
        state.active[tile] = moves
        if not moves:
            state.due_ns[tile] = _due(values, end_ns)
