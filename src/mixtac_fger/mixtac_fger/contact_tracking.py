# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The contact at 500 Hz: onset and end from force and picture, shape from frames and events.

A weak force counts as a contact only if it lasts and if a picture shows more displacement than was
left after the last contact. Without this check, noise of the estimate before a frame corrects it,
or gel that creeps back, would count as a contact. During a release the estimate is late, so it is
extrapolated with its own slope. Times and thresholds were chosen on 34 simulated sensors. The local
event rate does not detect a touch earlier than the force does.

Where frames are encoded, a contact is fitted to the displacement of the beads. Between frames, its
parameters follow the displacement that events measure, by the gains of the fit: a product of a
small matrix and a vector per window. Events measure displacements in contrast thresholds. The size
of a threshold is estimated from the events between two frames.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from mixtac_fger.contact import SIGNIFICANT, contact_shape, is_sensible
from mixtac_fger.displacement import DisplacementField, SkinScale
from mixtac_fger.features import bin_cells

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_fger.contact import ContactShape, Touch

    F32 = NDArray[np.float32]

HISTORY: Final = 128
"""Windows whose sums of the flow are kept: frames arrive later than they are exposed."""
THRESHOLD: Final = 0.25
"""Contrast threshold before the first frames [log units]."""
THRESHOLD_WEIGHT: Final = 20.0
"""Weight of that, as a sum of squares of flow [px^2 per threshold^2]."""
MEMORY: Final = 0.98
"""Share of the weight of earlier frames that is left after a frame."""
MOST_CARRIED_MM: Final = 1.0
"""Farthest that events carry a place from where the latest frame had it, along each axis [mm]."""
REST_SHARE: Final = 0.01
"""Share of the force without contact that its mean takes over per window: 0.2 s."""
MOST_REST_N: Final = 0.05
"""Largest estimate that counts as an offset without contact [N]."""
UNSEEN_N: Final = 0.1
"""Largest force of a contact that a picture may fail to show [N]."""
UNSEEN_US: Final = 40_000
"""Time from the begin of a contact after which a picture that shows none ends it [us]."""
SURE_WINDOWS: Final = 4
"""Windows for which a force above the threshold has to last, and a picture to show more."""
SURE_SHARE: Final = 5.0
"""Force over the threshold from which on one window is enough."""
LEAD_S: Final = 0.008
"""Time by which the slope of the force leads it in a release [s]."""
LEAD_BELOW_N: Final = 0.3
"""Largest force that is led [N]."""
YOUNG_US: Final = 60_000
"""Age of a contact up to which it is not led: a frame may still correct its force [us]."""
SLOPE_WINDOWS: Final = 5
"""Windows over which the slope is computed."""


@dataclass(frozen=True, slots=True)
class ContactSettings:
    """How contacts are found.

    Attributes:
        on_n: Force above which there is contact [N].
        off_n: Force at or below which there is no contact [N]; smaller than `on_n`.
        object_radius: Radius of curvature of what touches [mm]; 0 if it is not known.
        scale: Of the skin in the picture.
    """

    on_n: float = 0.03
    off_n: float = 0.02
    object_radius: float = 0.0
    scale: SkinScale = field(default_factory=SkinScale)


class Contact(NamedTuple):
    """The contact at the end of a window.

    Attributes:
        touching: Whether something touches the sensor.
        shape: Place and shape, in the contact frame; None without contact and until a frame has
            shown where it is.
    """

    touching: bool
    shape: ContactShape | None


class FlowCarrier:
    """Sums the displacement that events measure, and estimates the size of their thresholds.

    Args:
        shape: Rows and columns of the event grid.

    Attributes:
        threshold: Displacement per displacement in thresholds [log units].
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self._shape = shape
        self._sum = np.zeros((*shape, 2))
        self._past: deque[tuple[int, NDArray[np.float64]]] = deque(maxlen=HISTORY)
        self._frame: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
        self._both = self._own = 0.0

    @property
    def threshold(self) -> float:
        """Size of a contrast threshold, by frames and events so far [log units]."""
        fit = (self._both + THRESHOLD * THRESHOLD_WEIGHT) / (self._own + THRESHOLD_WEIGHT)
        return min(max(fit, 0.1), 0.6)

    def window(self, end_us: int, flow: F32) -> None:
        """Add the flow of a window, float32 [rows, columns, 2] [px per threshold]."""
        self._sum = self._sum + flow
        self._past.append((end_us, self._sum))

    def until(self, time_us: int) -> NDArray[np.float64]:
        """Return the sum of the flow at a time, camera clock [us]."""
        for end_us, total in reversed(self._past):
            if end_us <= time_us:
                return total
        return self._past[0][1] if self._past else self._sum

    def since(self, start: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the displacement of each cell since a sum of `until` [px]."""
        return self.threshold * (self._sum - start)

    def frame(self, start: NDArray[np.float64], field: DisplacementField) -> None:
        """Compare the displacement by events between two frames with that by the frames.

        Args:
            start: Sum of the flow at the frame.
            field: Displacement at the frame.
        """
        weight = field.tensor[0] + field.tensor[2]
        weights = _pooled(weight, self._shape)
        moved = np.stack([_pooled(weight * each, self._shape) for each in field.moved], axis=-1)
        moved /= np.maximum(weights, 1e-12)[..., None]
        before, self._frame = self._frame, (moved, start)
        if before is None:
            return
        change, flow = moved - before[0], start - before[1]
        self._both = MEMORY * self._both + float(np.sum(change * flow))
        self._own = MEMORY * self._own + float(np.sum(flow * flow))


def _pooled(values: F32, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return the sums of a map over the cells of a coarser grid."""
    rows = np.arange(shape[0]) * values.shape[0] // shape[0]
    columns = np.arange(shape[1]) * values.shape[1] // shape[1]
    return np.asarray(np.add.reduceat(np.add.reduceat(values, rows, 0), columns, 1), np.float64)


class ContactTracker:
    """Follows the contact of a stream, window by window.

    Args:
        settings: How contacts are found.
        grid: Rows and columns of the event grid.

    Attributes:
        settings: As given.
        touch: The contact in the latest frame; None without one.
        frame_us: Centre of its exposure, camera clock [us].
    """

    def __init__(self, settings: ContactSettings, grid: tuple[int, int]) -> None:
        self.settings, self._grid = settings, grid
        self.touch: Touch | None = None
        self.frame_us, self._dent = 0, 0.0
        self.clear()

    def frame(self, mid_us: int, touch: Touch) -> None:
        """Add a frame.

        Args:
            mid_us: Centre of its exposure, camera clock [us].
            touch: The contact in it.
        """
        self.touch, self.frame_us, self._start = touch, mid_us, self._carrier.until(mid_us)
        self._dent = min(self._dent, touch.fit.significance)
        self._carrier.frame(self._start, touch.field)
        lasting = mid_us > self._since_us + UNSEEN_US
        if self._touching and lasting and not touch.fit.seen and self._force_n < UNSEEN_N:
            # What is left of a release: the gel relaxes, and the estimate with it.
            self._end()
            self._rest_n = min(max(self._force_n, -MOST_REST_N), MOST_REST_N)

    def window(self, end_us: int, force: float, flow: F32) -> Contact:
        """Add a window and return the contact at its end.

        Args:
            end_us: End of the window, camera clock [us].
            force: Normal force [N].
            flow: Of the window, float32 [rows, columns, 2] of the event grid [px per threshold].
        """
        self._carrier.window(end_us, flow)
        self._switch(end_us, force)
        touch = self.touch
        if not self._touching or touch is None or not touch.fit.seen:
            return Contact(self._touching, None)
        return Contact(touching=True, shape=self._shape(touch))

    def moved(self) -> F32:
        """Return the displacement now, by the latest frame and events, as its field has it [px]."""
        assert self.touch is not None  # noqa: S101  (the caller waits for a frame)
        field = self.touch.field
        carried = self._carrier.since(self._start)
        rows, columns = bin_cells(field.moved.shape[1:], carried.shape[:2])
        along = carried[rows[:, None], columns].transpose(2, 0, 1)
        return np.asarray(field.moved + along, np.float32)

    def clear(self) -> None:
        """Forget frames and contact."""
        self.touch = None
        self._carrier = FlowCarrier(self._grid)
        self._start = self._carrier.until(0)
        self._touching = False
        self._since_us = 0
        self._force_n: float = 0.0
        self._rest_n = self._low_n = 0.0
        self._above = 0
        # The first frame may show a contact: it is not what is usual.
        self._dent = 0.0
        self._recent: deque[tuple[int, float]] = deque(maxlen=SLOPE_WINDOWS + 1)

    def _switch(self, end_us: int, force: float) -> None:
        self._force_n = force
        free = self.touch is not None and not self.touch.fit.seen
        if free and not self._touching and abs(force) < MOST_REST_N:
            self._rest_n += REST_SHARE * (force - self._rest_n)
        above = force - self._rest_n
        self._recent.append((end_us, above))
        if self._touching:
            # An estimate that swings below zero in a release comes back without a touch.
            self._low_n = max(above, 0.0)
            if not self._goes_on(end_us, above):
                self._end()
        else:
            # What a release leaves of the estimate is no new contact.
            self._low_n = min(self._low_n, max(above, 0.0))
            self._begin(end_us, above - self._low_n)

    def _end(self) -> None:
        self._touching = False
        if self.touch is not None:
            self._dent = self.touch.fit.significance

    def _begin(self, end_us: int, risen: float) -> None:
        """Find out whether a contact begins, by how far the force has risen [N]."""
        self._above = self._above + 1 if risen > self.settings.on_n else 0
        # The latest picture has to show more than what the last contact left.
        more = self.touch is None or self.touch.fit.significance > self._dent + SIGNIFICANT
        lasting = self._above >= SURE_WINDOWS and more
        self._touching = lasting or risen > SURE_SHARE * self.settings.on_n
        if self._touching:
            self._since_us, self._above = end_us, 0

    def _goes_on(self, end_us: int, above: float) -> bool:
        """Return whether a contact goes on at a force [N]."""
        before_us, before = self._recent[0]
        slope = 1e6 * (above - before) / max(end_us - before_us, 1)
        led = above < LEAD_BELOW_N and end_us > self._since_us + YOUNG_US
        lead = LEAD_S * min(slope, 0.0) if led else 0.0
        return above + lead > self.settings.off_n

    def _shape(self, touch: Touch) -> ContactShape:
        fit = touch.fit
        p = fit.parameters
        change = fit.gains.reshape(len(p), -1) @ self._carrier.since(self._start).ravel()
        change[3:5] = np.clip(change[3:5], -MOST_CARRIED_MM, MOST_CARRIED_MM)
        carried = p + change
        if carried[0] > 0.0 and is_sensible(carried):
            p = carried
        return contact_shape(p, fit.covariance, self.settings.scale, self.settings.object_radius)
