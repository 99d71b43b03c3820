# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The loops of the DVS pixels, tile by tile, so that they vectorise."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from mixtac_sim.array_geometry import TILE, TILES

if TYPE_CHECKING:
    from numpy.typing import NDArray

SETTLED = np.float32(1e-3)
"""Distance from the light's logarithm at which a pixel counts as settled."""
NEVER = np.int64(1) << 62
"""A time that does not come [ns]."""
_LN2 = np.float32(0.6931471805599453)
_PER_ONE = np.float32(1.0 / 65536.0)
_F = np.float32


class PixelState(NamedTuple):
    """State of the pixels; arrays over padded pixels unless over tiles.

    Attributes:
        light: Illuminance [lx], float32.
        light_bits: The same memory as int32.
        log: Its natural logarithm, float32.
        follow: What the pixel has followed of it, float32.
        difference: ``follow`` less its value at the last event, plus leak, float32.
        on: ON threshold, float32.
        off: OFF threshold, float32.
        leak: Rise of the difference [1/s], float32.
        ready_ns: When the pixel sees again after an event [ns], int64.
        last_ns: Until when a tile is up to date [tiles] [ns], int64.
        due_ns: When a skipped tile's first leak event comes [tiles] [ns], int64.
        active: Whether a tile has not settled [tiles], uint8.
    """

    light: NDArray[np.float32]
    light_bits: NDArray[np.int32]
    log: NDArray[np.float32]
    follow: NDArray[np.float32]
    difference: NDArray[np.float32]
    on: NDArray[np.float32]
    off: NDArray[np.float32]
    leak: NDArray[np.float32]
    ready_ns: NDArray[np.int64]
    last_ns: NDArray[np.int64]
    due_ns: NDArray[np.int64]
    active: NDArray[np.uint8]


@njit(cache=True, nogil=True)
def light_of(
    floor: NDArray[np.float32], gain: NDArray[np.float32], cover: NDArray[np.int32]
) -> NDArray[np.float32]:
    """Return the light under a cover; thick cover hides what is behind it, nearly exp(-s)."""
    light = np.empty_like(floor)
    for p in range(floor.size):
        light[p] = _lit(floor[p], gain[p], cover[p])
    return light


@njit(cache=True, nogil=True, inline='always')
def _lit(floor: float, gain: float, cover: int) -> float:
    s = _F(cover) * _PER_ONE
    through = _F(1.0) / (_F(1.0) + s * (_F(1.0) + s * (_F(0.5) + s * _F(1.0 / 6.0))))
    return floor + gain * (_F(1.0) - through)


@njit(cache=True, nogil=True)
def _log(
    bits: NDArray[np.int32],
    work: NDArray[np.int32],
    mantissa: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Write the natural logarithm of positive floats given by their bits, exact to 2e-6."""
    for j in range(TILE):
        work[j] = (bits[j] & 0x7FFFFF) | 0x3F800000
    for j in range(TILE):
        z = (mantissa[j] - _F(1.0)) / (mantissa[j] + _F(1.0))
        q = z * z
        series = _F(1 / 7) + q * (_F(1 / 9) + q * _F(1 / 11))
        series = _F(1.0) + q * (_F(1 / 3) + q * (_F(1 / 5) + q * series))
        out[j] = _F((bits[j] >> 23) - 127) * _LN2 + _F(2.0) * z * series


@njit(cache=True, nogil=True)
def _follow(
    light: NDArray[np.float32],
    before: NDArray[np.float32],
    after: NDArray[np.float32],
    follow: NDArray[np.float32],
    difference: NDArray[np.float32],
    leak: NDArray[np.float32],
    on: NDArray[np.float32],
    off: NDArray[np.float32],
    corners: tuple[float, float],
    step_s: float,
) -> tuple[int, int]:
    """Advance the low-pass and the difference; return whether any pixel fires, any still moves."""
    source, per_lux = _F(corners[0]), _F(corners[1])
    phase = _F(2.0 * np.pi * step_s)
    step = _F(step_s)
    fires, moves = np.int32(0), np.int32(0)
    for j in range(TILE):
        photo = per_lux * light[j]
        x = max(phase * photo * source / (photo + source), _F(1e-3))
        kept = _F(1.0) / (
            _F(1.0) + x * (_F(1.0) + x * (_F(0.5) + x * (_F(1 / 6) + x * _F(1 / 24))))
        )
        rise = after[j] - before[j]
        value = kept * follow[j] + (_F(1.0) - kept) * before[j]
        value += rise * (_F(1.0) - (_F(1.0) - kept) / x)
        changed = difference[j] + (value - follow[j]) + leak[j] * step
        follow[j] = value
        difference[j] = changed
        fires |= np.int32(changed > on[j]) | np.int32(changed < -off[j])
        moves |= np.int32(abs(after[j] - value) > SETTLED)
    return fires, moves


@njit(cache=True, nogil=True)
def _fire(
    state: PixelState,
    p: int,
    start: float,
    end: float,
    start_ns: int,
    end_ns: int,
    refractory_ns: int,
    block_ns: int,
    keys: NDArray[np.int64],
    count: NDArray[np.int64],
) -> None:
    """Find the events of one pixel whose difference went from ``start`` to ``end``."""
    span = float(end_ns - start_ns)
    since = max(float(state.ready_ns[p] - start_ns), 0.0)
    if since >= span:
        return
    on, off = float(state.on[p]), float(state.off[p])
    slope = (end - start) / span
    value = start + slope * since
    while True:
        if value >= on or value <= -off:
            ahead = 0.0
        elif slope > 0.0:
            ahead = (on - value) / slope
        elif slope < 0.0:
            ahead = (-off - value) / slope
        else:
            break
        if since + ahead > span:
            break
        since += ahead
        rising = value >= on or (value > -off and slope > 0.0)
        if count[0] < keys.size:
            at = start_ns - block_ns + int(since)
            keys[count[0]] = (at << 18) | (p << 1) | (1 if rising else 0)
            count[0] += 1
        else:
            count[1] += 1
        since += refractory_ns
        value = 0.0
        state.ready_ns[p] = start_ns + int(since)
        if since >= span:
            state.difference[p] = 0.0
            return
    state.difference[p] = value + slope * (span - since)


@njit(cache=True, nogil=True)
def _due(
    difference: NDArray[np.float32],
    leak: NDArray[np.float32],
    on: NDArray[np.float32],
    end_ns: int,
) -> int:
    """Return when the first of a tile's pixels leaks over its threshold [ns]."""
    soonest = 1e9
    for j in range(TILE):
        if leak[j] > 0.0:
            soonest = min(soonest, float(on[j] - difference[j]) / float(leak[j]))
    return end_ns + np.int64(max(soonest, 0.0) * 1e9) if soonest < 1e9 else NEVER


@njit(cache=True, nogil=True)
def develop(
    state: PixelState,
    floor: NDArray[np.float32],
    gain: NDArray[np.float32],
    cover: NDArray[np.int32],
    dirty: NDArray[np.uint8],
    corners: tuple[float, float],
    refractory_ns: int,
    start_ns: int,
    end_ns: int,
    block_ns: int,
    keys: NDArray[np.int64],
    count: NDArray[np.int64],
) -> None:
    """Advance all pixels over one step; see ``Dvs.step``."""
    work = np.empty(TILE, np.int32)
    mantissa = work.view(np.float32)
    before, after = np.empty(TILE, np.float32), np.empty(TILE, np.float32)
    earlier = np.empty(TILE, np.float32)
    step_s = 1e-9 * (end_ns - start_ns)
    for tile in range(TILES):
        if not (dirty[tile] or state.active[tile] or state.due_ns[tile] <= end_ns):
            continue
        first = tile * TILE
        here = slice(first, first + TILE)
        idle_s = np.float32(1e-9 * (start_ns - state.last_ns[tile]))
        difference, leak, log = state.difference[here], state.leak[here], state.log[here]
        for j in range(TILE):
            difference[j] += leak[j] * idle_s
            earlier[j] = difference[j]
            before[j] = log[j]
            after[j] = log[j]
        if dirty[tile]:
            for p in range(first, first + TILE):
                state.light[p] = _lit(floor[p], gain[p], cover[p])
            _log(state.light_bits[here], work, mantissa, after)
            for j in range(TILE):
                log[j] = after[j]
            dirty[tile] = 0
        on, off = state.on[here], state.off[here]
        fires, moves = _follow(
            state.light[here],
            before,
            after,
            state.follow[here],
            difference,
            leak,
            on,
            off,
            corners,
            step_s,
        )
        if fires:
            for j in range(TILE):
                if difference[j] > on[j] or difference[j] < -off[j]:
                    _fire(
                        state,
                        first + j,
                        earlier[j],
                        difference[j],
                        start_ns,
                        end_ns,
                        refractory_ns,
                        block_ns,
                        keys,
                        count,
                    )
        state.last_ns[tile] = end_ns
        state.active[tile] = moves
        if not moves:
            state.due_ns[tile] = _due(difference, leak, on, end_ns)
