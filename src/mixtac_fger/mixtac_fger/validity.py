# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whether a force can be trusted, and why not.

Two checks use the pictures, in 48 tiles. Both are relative to the noise and the pattern of this
sensor, so that its brightness, its contrast and its rates have no effect.

* **Picture.** The picture of a pressed gel is the displaced reference. It passes if the residual to
  the displaced reference, less the noise from frame to frame, is a small part of the variance of
  the pattern, or less than half of the change. The gel is bonded at its border, so the picture as a
  whole must not move.
* **Events.** Where the change from one frame to a later one exceeds its noise, the events between
  the two must show the same motion: ON events where pixels have become brighter.

The noise of a tile is the lower envelope of its mean squares. The mean square of 120 bins of white
noise has a standard deviation of 13 %. The envelope lies two standard deviations below the mean and
`SIGNAL` four above it, which one tile in 30,000 exceeds by chance. A fault is reported for six
tiles of one frame, or for three frames of five, so that noise alone causes less than one report in
ten hours.
"""

from __future__ import annotations

import math
from collections import deque
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_fger.displacement import displaced

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U16 = NDArray[np.uint16]
Bools = NDArray[np.bool_]


class Reason(IntEnum):
    """Why a force cannot be trusted; the numbers are those of `mixtac_msgs/ForceQuality`."""

    TRUSTED = 0
    PICTURE_UNLIKE_REFERENCE = 1
    FRAME_FROZEN = 3
    EVENTS_DISAGREE = 6
    OTHER_CAMERA = 8
    ZERO_UNKNOWN = 9
    OUT_OF_RANGE = 10
    SATURATED = 11
    STALE = 12

    @property
    def text(self) -> str:
        """The reason and its remedy, in one line."""
        return TEXTS[self]


TEXTS = {
    Reason.TRUSTED: 'trusted',
    Reason.PICTURE_UNLIKE_REFERENCE: 'the picture is not the reference displaced by a contact:'
    ' check LEDs, focus and the fixing of the camera, release the sensor and call ~/tare',
    Reason.FRAME_FROZEN: 'the camera sends the same frame again and again: restart the driver',
    Reason.EVENTS_DISAGREE: 'events and frames show different motions: check that camera, times,'
    ' orientation and biases are right',
    Reason.OTHER_CAMERA: 'another camera was connected: release the sensor and call ~/tare',
    Reason.ZERO_UNKNOWN: 'the zero is unknown: touch the sensor, release it and call ~/tare, or set'
    ' assume_free if nothing touched it at the start',
    Reason.OUT_OF_RANGE: 'the force is outside of what the model was trained on',
    Reason.SATURATED: 'the sensor sent more events than it can, until the next frame',
    Reason.STALE: 'the latest frame is too old',
}
TILE_ROWS = 6
"""Rows of tiles of a picture; a tile shows about eight beads."""
TILE_COLUMNS = 8
"""Columns of tiles of a picture."""
SPARE_TILES = 5
"""Tiles that may be unlike the reference: those below a sharp or heavy contact, and a defect."""
PATTERN_SHARE = 0.2
"""Largest residual of a tile like the reference, over the variance of its pattern: a correlation
of 0.9."""
CHANGE_SHARE = 0.5
"""Largest residual of a tile that a displacement explains, over its change."""
MOST_SHIFT = 0.1
"""Largest displacement of the whole picture while the camera is fixed [bins of 4 px]."""
FALL = 0.2
"""Share by which a level of noise follows a lower value."""
RISE = 0.002
"""Share by which a level of noise follows a higher value: in 20 s at 25 Hz."""
SIGNAL = 2.0
"""Smallest mean square of a tile that shows more than noise, over its level of noise."""
REST_SHARE = 0.25
"""Share of the tiles that rests in every contact."""
STRONG = 0.3
"""Root mean square of a tile above which frames and events must agree [events/px]."""
ONE_WAY = 0.7
"""Smallest share of ON less OFF events in all events of a tile that moved one way."""
LEAST_AGREEMENT = 0.2
"""Smallest correlation of frames and events that agree."""
JUDGED_FRAMES = 5
"""Frames with motion whose median agreement is judged."""
REST_FRAMES = 25
"""Frames without motion after which a disagreement is forgotten."""
HOLD_FRAMES = 5
"""Frames without a finding after which a force is trusted again."""
KEPT_WINDOWS = 256
"""Windows whose events are kept for the next frame."""


@njit(cache=True, nogil=True)
def tile_moments(a: F32, b: F32, out: F64) -> None:
    """Write means, variances and covariance of two maps in each tile.

    Args:
        a: float32 [rows, columns].
        b: The same.
        out: Mean of a and of b, variance of a and of b, covariance; float64 [5, tiles].
    """
    rows, columns = a.shape
    for tile in range(out.shape[1]):
        row, column = tile // TILE_COLUMNS, tile % TILE_COLUMNS
        top, bottom = row * rows // TILE_ROWS, (row + 1) * rows // TILE_ROWS
        left, right = column * columns // TILE_COLUMNS, (column + 1) * columns // TILE_COLUMNS
        x = y = xx = yy = xy = np.float64(0.0)
        for i in range(top, bottom):
            for j in range(left, right):
                p, q = np.float64(a[i, j]), np.float64(b[i, j])
                x, y, xx, yy, xy = x + p, y + q, xx + p * p, yy + q * q, xy + p * q
        count = (bottom - top) * (right - left)
        x, y = x / count, y / count
        out[0, tile], out[1, tile] = x, y
        out[2, tile], out[3, tile] = xx / count - x * x, yy / count - y * y
        out[4, tile] = xy / count - x * y


@njit(cache=True, nogil=True)
def add_events(x: U16, y: U16, on: Bools, size: int, net: NDArray[np.int8]) -> None:
    """Add ON less OFF events to bins of `size` pixels, int8 [rows, columns], up to 127."""
    rows, columns = net.shape
    for index in range(x.shape[0]):
        row, column = y[index] // size, x[index] // size
        if row < rows and column < columns:
            value = int(net[row, column]) + (1 if on[index] else -1)
            net[row, column] = min(max(value, -127), 127)


@njit(cache=True, nogil=True)
def sum_windows(
    windows: NDArray[np.int8], chosen: Bools, scale: float, way: F32, path: F32
) -> None:
    """Add windows to maps of the way, and of the way without its sign, float32 [rows, columns]."""
    for index in range(windows.shape[0]):
        if chosen[index]:
            for row in range(way.shape[0]):
                for column in range(way.shape[1]):
                    step = np.float32(scale) * np.float32(windows[index, row, column])
                    way[row, column] += step
                    path[row, column] += abs(step)


def middle(values: F64, share: float = 0.5) -> float:
    """Return a quantile of a few values."""
    place = int(share * len(values))
    return float(np.partition(values, place)[place])


class PictureFigures(NamedTuple):
    """A picture compared with the reference.

    Attributes:
        residual: Mean square of each tile that is left once the reference is displaced [log
            units^2], float64 [tiles].
        change: The same without the displacement.
        pattern: Variance of each tile of the reference [log units^2].
        shift: Displacement of the median tile, or of the median of the tiles along the border where
            that is less: a pull on a wide contact moves more than half of the picture [bins].
        outward: Mean component of the displacement away from where it is largest [bins].
    """

    residual: F64
    change: F64
    pattern: F64
    shift: float
    outward: float

    def unexplained(self, noise: F64 | float = 0.0) -> float:
        """Return how much of the picture no contact explains; a fault from 1 on.

        Args:
            noise: Mean square of the noise of each tile [log units^2].
        """
        left = self.residual - noise
        parts = np.minimum(
            left / (PATTERN_SHARE * self.pattern + 1e-9),
            left / (CHANGE_SHARE * np.maximum(self.change - noise, 0.0) + 1e-9),
        )
        return max(float(np.sort(parts)[-1 - SPARE_TILES]), self.shift / MOST_SHIFT)


def picture_figures(reference: F32, image: F32, flow: F32) -> PictureFigures:
    """Compare a picture with the reference.

    Args:
        reference: Coarse log contrast without contact, float32 [rows, columns].
        image: Coarse log contrast now, same shape.
        flow: Displacement of the image against the reference along x and y [bins], float32
            [2, rows, columns], of `mixtac_core.events.frames.displacement`.
    """
    tiles = np.empty((3, 5, TILE_ROWS * TILE_COLUMNS))
    moved = np.empty_like(reference)
    displaced(reference, flow, moved)
    tile_moments(image - moved, image - reference, tiles[0])
    tile_moments(reference, reference, tiles[1])
    tile_moments(flow[0], flow[1], tiles[2])
    shade = (tiles[0, 0] - middle(tiles[0, 0])) ** 2
    u, v = tiles[2, 0], tiles[2, 1]
    most = middle(u), middle(v)
    y, x = np.divmod(np.arange(len(u)), TILE_COLUMNS)
    border = (x % (TILE_COLUMNS - 1) == 0) | (y % (TILE_ROWS - 1) == 0)
    shift = min(math.hypot(*most), math.hypot(middle(u[border]), middle(v[border])))
    u, v = u - most[0], v - most[1]
    weights = u * u + v * v
    weights /= weights.sum() + 1e-12
    away_x, away_y = x - weights @ x, y - weights @ y
    outward = (u * away_x + v * away_y) / (np.hypot(away_x, away_y) + 1e-3)
    residual, change = tiles[0, 2] + shade, tiles[0, 3] + shade
    return PictureFigures(residual, change, tiles[1, 2], shift, float(outward.mean()))


class Validity:
    """Follows frames and windows, and reports why the force cannot be trusted.

    Memory is bounded; the work per window does not depend on what came before.

    Args:
        width: Columns of the sensor [px].
    """

    def __init__(self, width: int) -> None:
        self._width = width
        self.forget()

    def forget(self) -> None:
        """Forget the sensor: its noise, and the events per unit of change."""
        tiles = TILE_ROWS * TILE_COLUMNS
        self._noise, self._murmur = np.zeros(tiles), np.zeros(tiles)
        self._gain = 0.0
        self.clear()

    def clear(self) -> None:
        """Forget the stream: a restart of its clock. Noise is kept."""
        self._held: dict[Reason, int] = {}
        self._agreements = deque([1.0] * JUDGED_FRAMES, JUDGED_FRAMES)
        self._rested = 0
        self.skip()

    def skip(self) -> None:
        """Go on after a hole in the stream: reported faults remain until they are resolved."""
        self._before: tuple[int, F32] | None = None
        self._ends = np.full(KEPT_WINDOWS, -1, np.int64)
        self._net = np.zeros((KEPT_WINDOWS, 1, 1), np.int8)
        self._next = self._age = 0

    @property
    def reason(self) -> Reason:
        """Reason not to trust the force, from the latest frames and windows; else `TRUSTED`."""
        return min(self._held) if self._held else Reason.TRUSTED

    def window(self, end_us: int, events: Events, *, complete: bool) -> None:
        """Add a window.

        Args:
            end_us: Its end, camera clock [us].
            events: Its events.
            complete: Whether all of its packets arrived.
        """
        if not complete:
            self.skip()
        if self._before is None:
            return
        place, self._next = self._next, (self._next + 1) % KEPT_WINDOWS
        self._ends[place], self._net[place] = end_us, 0
        size = self._width // self._net.shape[2]
        add_events(events.x, events.y, events.polarity, size, self._net[place])

    def frame(
        self, mid_us: int, contrast: F32 | None, picture: PictureFigures | None = None
    ) -> None:
        """Add a frame that corrects the estimate.

        Args:
            mid_us: Centre of its exposure, camera clock [us].
            contrast: Its coarse log contrast, float32 [rows, columns]; None if unknown.
            picture: Comparison with the reference; None without one.
        """
        found = set()
        if contrast is not None:
            found = self._compare(mid_us, contrast)
        if picture is not None and picture.unexplained(self._noise) > 1.0:
            found.add(Reason.PICTURE_UNLIKE_REFERENCE)
        self._held = {reason: left - 1 for reason, left in self._held.items() if left > 1}
        self._held |= dict.fromkeys(found, HOLD_FRAMES)

    def _compare(self, mid_us: int, contrast: F32) -> set[Reason]:
        """Return the checks that a frame and the events since the previous frames fail."""
        before, self._before = self._before, (mid_us, contrast)
        if before is None:
            self._net = np.zeros((KEPT_WINDOWS, *contrast.shape), np.int8)
            self._start(contrast)
            return set()
        if np.array_equal(before[1], contrast):
            return {Reason.FRAME_FROZEN}
        self._age += 1
        way, path = np.zeros((2, *contrast.shape), np.float32)
        chosen = (self._ends > before[0]) & (self._ends <= mid_us)
        scale = 1.0 / (self._width // contrast.shape[1]) ** 2
        sum_windows(self._net, chosen, scale, way, path)
        moments = np.empty((5, len(self._noise)))
        tile_moments(contrast - before[1], way, moments)
        changed = moments[2] / 2.0
        self._noise = follow(self._noise, changed)
        self._murmur = follow(self._murmur, moments[3])
        # Some part of the skin rests: where all of it changes more than usual, noise has grown.
        grown = max(1.0, middle(changed / self._noise, REST_SHARE))
        self._way += way
        self._path += path
        moved = self._judge(2.0 * grown * self._noise, contrast)
        self._rested = 0 if moved else self._rested + 1
        if moved or self._age >= JUDGED_FRAMES:
            self._start(contrast)
        if self._rested == REST_FRAMES:
            self._agreements.extend([1.0] * JUDGED_FRAMES)
        wrong = sorted(self._agreements)[JUDGED_FRAMES // 2] < LEAST_AGREEMENT
        return {Reason.EVENTS_DISAGREE} if wrong else set()

    def _start(self, contrast: F32) -> None:
        """Compare the next frames with this one."""
        self._anchor: F32 = contrast
        self._age = 0
        self._way: F32 = np.zeros_like(contrast)
        self._path: F32 = np.zeros_like(contrast)

    def _judge(self, noise: F64, contrast: F32) -> bool:
        """Correlate a strong change of the frames since the start with the events.

        Args:
            noise: Variance of the change in each tile without motion [log units^2].
            contrast: Of the latest frame.

        Returns:
            Whether the frames show so much motion that events must show it too.
        """
        moments = np.empty((5, len(noise)))
        tile_moments(contrast - self._anchor, self._way, moments)
        _, _, changed, signs, both = moments
        # Hot pixels go on and on with one sign, and nothing moves.
        murmur = self._age**2 * self._murmur
        moved = np.where(changed > SIGNAL * noise, changed - noise, 0.0)
        fired = np.where((signs > SIGNAL * murmur) & (moved > 0.0), signs - murmur, 0.0)
        # A pixel does not report a change below its threshold.
        used = np.maximum(self._gain**2 * moved, fired) > STRONG**2
        if used.any():
            # What moved to and fro is not in the frames.
            moments = np.empty_like(moments)
            tile_moments(np.abs(self._way), self._path, moments)
            used &= moments[0] >= ONE_WAY * moments[1]
        if not used.any():
            return False
        total, of_frames, of_events = (float(each[used].sum()) for each in (both, changed, signs))
        agreement = total / math.sqrt(of_frames * of_events + 1e-12)
        self._agreements.append(agreement)
        if agreement > CHANGE_SHARE:
            self._gain += (FALL if self._gain else 1.0) * (total / of_frames - self._gain)
        return True


def follow(level: F64, value: F64) -> F64:
    """Return a level of noise after another value, its lower envelope; float64 [tiles]."""
    share = np.where(level == 0.0, 1.0, np.where(value < level, FALL, RISE))
    return np.asarray(level + share * (value - level))
