# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The DVS pixels: light to logarithm, first-order bandwidth, thresholds, refractory time, leak.

Every pixel follows the logarithm of its light with a corner that grows with the light up to the
source follower's; its difference to the value at the last event is compared with two thresholds,
while leak lets it rise slowly. Within a step light and difference are straight lines, the step of
the low-pass is exact for that, and events lie where the line meets a threshold. Tiles in which
nothing happens are skipped until their first leak event is due.

All values of a tile lie side by side in one array (`values[tile, row, pixel]`), so the compiler
knows that no row overlaps another and vectorises the loops, and a tile is one stretch of memory.
Constants name the rows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_sim.grids import PADDED, PIXELS, TILE, TILES
from mixtac_sim.optics.scene import Flicker, MeshMotion, Scene
from mixtac_sim.pixels.biases import PixelSettings, PixelSpread

FLOOR = 0
"""Row of the light without beads [lx]."""
GAIN = 1
"""Row of the light that beads add [lx]."""
LIGHT = 2
"""Row of the light [lx]."""
LOG = 3
"""Row of its logarithm."""
FOLLOW = 4
"""Row of the part of the logarithm that the pixel has followed."""
DIFFERENCE = 5
"""Row of that part less its value at the last event, plus leak."""
ON = 6
"""Row of the ON thresholds."""
OFF = 7
"""Row of the OFF thresholds."""
LEAK = 8
"""Row of the rise by leak and by a lamp that drifts [1/s]."""
BEFORE = 9
"""Row of the logarithm at the start of the step."""
EARLIER = 10
"""Row of the difference at the start of the step."""
SPARE = 11
"""Row of intermediate values."""
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
        ready_ns: End of the blind time of a pixel after an event [padded pixels] [ns], int64.
        last_ns: Until when a tile is up to date [tiles] [ns], int64.
        due_ns: Time from which a skipped tile may have an event [tiles] [ns], int64.
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


class Crossings(NamedTuple):
    """Buffer for threshold crossings.

    Attributes:
        keys: Packed as in ``readout``; times count from the block's start.
        tally: Number of keys [1], int64; crossings that do not fit are lost.
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
def _follow(values: NDArray[np.float32], corners: Corners, step_s: float) -> tuple[int, int]:
    """Advance low-pass and difference of a tile; return whether a pixel fires, whether one moves.

    The factor exp(-x) of a step is taken as 1 / (1 + x + x^2/2 + x^3/6 + x^4/24), which is within
    1 % while the pixel still remembers anything and goes to zero as it should.
    """
    source, per_lux = _F(corners.source_hz), _F(corners.hz_per_lux)
    phase, step = _F(2.0 * np.pi * step_s), _F(step_s)
    fires, moves = np.int32(0), np.int32(0)
    for j in range(TILE):
        photo = per_lux * values[LIGHT, j]
        x = max(phase * photo * source / (photo + source), _F(1e-3))
        kept = _F(1.0) / (
            _F(1.0) + x * (_F(1.0) + x * (_F(0.5) + x * (_F(1 / 6) + x * _F(1 / 24))))
        )
        now, before = values[LOG, j], values[BEFORE, j]
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
def _ripple(
    values: NDArray[np.float32], corners: Corners, ripple: Flicker, last_ns: int, end_ns: int
) -> int:
    """Add the steady response to a small ripple since a tile's last step; return whether one fires.

    A first-order pixel of corner c answers sin(wt) with [sin(wt) - q cos(wt)] / (1 + q^2), q = f/c.
    """
    source, per_lux = _F(corners.source_hz), _F(corners.hz_per_lux)
    turn, phase = 2.0 * np.pi * ripple.hz * 1e-9, 2.0 * np.pi * ripple.phase
    first, last = turn * last_ns + phase, turn * end_ns + phase
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
        if crossings.tally[0] < crossings.keys.size:
            at_ns = start_ns - block_ns + int(since)
            crossings.keys[crossings.tally[0]] = (at_ns << 18) | (pixel << 1) | (1 if rising else 0)
            crossings.tally[0] += 1
        since += refractory_ns
        value = 0.0
        state.ready_ns[pixel] = start_ns + int(since)
        if since >= span:
            values[DIFFERENCE, j] = 0.0
            return
    values[DIFFERENCE, j] = value + slope * (span - since)


@njit(cache=True, nogil=True, error_model='numpy')
def _due(values: NDArray[np.float32], corners: Corners, ripple: Flicker, end_ns: int) -> int:
    """Return when the first of a tile's settled pixels may pass a threshold [ns].

    A ripple takes a pixel over its threshold at a crest. So a pixel is due as soon as a crest would
    do so; were it left alone, all such pixels of a tile would fire when something else wakes it.
    """
    source, per_lux = _F(corners.source_hz), _F(corners.hz_per_lux)
    turn = 2.0 * np.pi * ripple.hz * 1e-9 * end_ns + 2.0 * np.pi * ripple.phase
    sine, cosine = _F(np.sin(turn)), _F(np.cos(turn))
    depth, frequency = _F(ripple.depth), _F(ripple.hz)
    soonest = 1e9
    for j in range(TILE):
        crest = here = _F(0.0)
        if depth > 0.0:
            q = frequency * (_F(1.0) / source + _F(1.0) / (per_lux * values[LIGHT, j]))
            square = _F(1.0) + q * q
            crest, here = depth / np.sqrt(square), depth * (sine - q * cosine) / square
        mean = values[DIFFERENCE, j] - here
        if depth > 0.0 and mean - crest < -values[OFF, j]:
            return end_ns
        rise = float(values[LEAK, j])
        if rise != 0.0:
            away = values[ON, j] - mean if rise > 0.0 else values[OFF, j] + mean
            soonest = min(soonest, float(away - crest) / abs(rise))
    if soonest >= 1e9:
        return NEVER
    return end_ns + int(max(soonest, 0.0) * 1e9)


@njit(cache=True, nogil=True, error_model='numpy')
def _blend(
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
    ripple: Flicker,
    start_ns: int,
    end_ns: int,
    block_ns: int,
    crossings: Crossings,
) -> None:
    """Advance all pixels over one step; see ``Dvs.step``."""
    step_s = 1e-9 * (end_ns - start_ns)
    for tile in range(TILES):
        if not (dirty[tile] or state.active[tile] or state.due_ns[tile] <= end_ns):
            continue
        values = state.values[tile]
        idle_s = _F(1e-9 * (start_ns - state.last_ns[tile]))
        for j in range(TILE):
            values[EARLIER, j] = values[DIFFERENCE, j] + values[LEAK, j] * idle_s
            values[BEFORE, j] = values[LOG, j]
        if dirty[tile]:
            relight(values, state.bits[tile], cover[tile * TILE : (tile + 1) * TILE])
            dirty[tile] = 0
        fires, moves = _follow(values, corners, step_s)
        if ripple.depth > 0.0:
            fires = _ripple(values, corners, ripple, state.last_ns[tile], end_ns)
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
            state.due_ns[tile] = _due(values, corners, ripple, end_ns)


CAPACITY = 1 << 20
"""Threshold crossings kept per block; a readout passes 50 000 in 4 ms."""
BEYOND = 1e9
"""A threshold that no difference of logarithms reaches."""


class Dvs:
    """All DVS pixels of a chip.

    Args:
        scene: Light on the array.
        spread: Differences between pixels.
        settings: Settings of this chip.
        rng: Draws where each pixel stands between its thresholds at the start.
    """

    def __init__(
        self,
        scene: Scene,
        spread: PixelSpread,
        settings: PixelSettings,
        rng: np.random.Generator,
    ) -> None:
        self._spread = spread
        self._state = _blank_state()
        self._row(FLOOR)[:] = _tiled(scene.floor)
        self._row(GAIN)[:] = _tiled(scene.gain)
        self.light_by(Flicker(0.0, 0.0))
        self._crossings = Crossings(np.empty(CAPACITY, np.int64), np.zeros(1, np.int64))
        self.configure(settings)
        # Pixels start anywhere between two leak events.
        self._row(DIFFERENCE)[:] = self._row(ON) * rng.random((TILES, TILE), np.float32)
        self.settle(np.zeros(PADDED, np.int32))

    def _row(self, row: int) -> NDArray[np.float32]:
        """Return one value of all pixels [tiles, 64], as a view."""
        return self._state.values[:, row]

    @property
    def light(self) -> NDArray[np.float32]:
        """Return the present light on the array [tiles, 64] [lx], as a view."""
        return self._row(LIGHT)

    def configure(self, settings: PixelSettings) -> None:
        """Change the settings from the next step on."""
        self._corners = Corners(
            settings.source_follower_hz, settings.hz_per_lux, int(1e3 * settings.refractory_us)
        )
        spread = self._spread
        self._row(ON)[:] = _tiled(settings.threshold_on * spread.on)
        self._row(OFF)[:] = _tiled(settings.threshold_off * spread.off)
        rate = settings.leak_hz + settings.leak_hz_per_lux * self._row(FLOOR)
        self._row(LEAK)[:] = rate * _tiled(spread.leak) * self._row(ON) + settings.drift_per_s
        # The last tile is longer than the array: what lies beyond must never fire.
        for row, value in ((ON, BEYOND), (OFF, BEYOND), (LEAK, 0.0)):
            self._row(row)[-1, PIXELS - PADDED :] = value
        self._state.active[:] = 1

    def light_by(self, flicker: Flicker) -> None:
        """Set the flicker of the lamp; steady before the first call."""
        self._flicker = flicker

    def settle(self, cover: NDArray[np.int32]) -> None:
        """Bring the pixels to the steady state under a cover.

        Args:
            cover: Cover of ``Renderer`` [padded pixels].
        """
        state = self._state
        for tile in range(TILES):
            covered = cover[tile * TILE : (tile + 1) * TILE]
            relight(state.values[tile], state.bits[tile], covered)
        self._row(FOLLOW)[:] = self._row(LOG)

    def step(
        self,
        cover: NDArray[np.int32],
        dirty: NDArray[np.uint8],
        start_ns: int,
        end_ns: int,
        block_ns: int,
    ) -> None:
        """Advance over one step in which the light moves to what the cover now gives.

        Args:
            cover: Cover of ``Renderer`` [padded pixels].
            dirty: Tiles whose cover changed; cleared.
            start_ns: Start of the step [ns of true time].
            end_ns: End of the step [ns].
            block_ns: Start of the block [ns], from which crossings count.
        """
        develop(
            self._state,
            cover,
            dirty,
            self._corners,
            self._flicker,
            start_ns,
            end_ns,
            block_ns,
            self._crossings,
        )

    def blend(self, mesh: MeshMotion, level: float) -> None:
        """Show the mesh at a place among its levels; the tiles in which it moves are dirty then."""
        _blend(self._state.values, mesh.floors, mesh.gains, mesh.tiles, level)

    def take(self) -> NDArray[np.int64]:
        """Return the crossings since the last call, unsorted, packed as in ``readout``."""
        keys, tally = self._crossings
        taken = keys[: tally[0]].copy()
        tally[0] = 0
        return taken


def _tiled(pixels: NDArray[np.float32]) -> NDArray[np.float32]:
    return pixels.reshape(TILES, TILE)


def _blank_state() -> PixelState:
    """Return arrays of the right sizes."""
    values = np.zeros((TILES, ROWS, TILE), np.float32)
    return PixelState(
        values=values,
        bits=values.view(np.int32),
        ready_ns=np.zeros(PADDED, np.int64),
        last_ns=np.zeros(TILES, np.int64),
        due_ns=np.zeros(TILES, np.int64),
        active=np.ones(TILES, np.uint8),
    )
