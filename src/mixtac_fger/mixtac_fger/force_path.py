# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""All forces between two frames: what the latest frame shows, and what events have added since.

A frame shows, in its moments (`mixtac_fger.moments`), the normal force by D, D r^2 and D r^4, the
sideways force along each axis by S and L, and the torsion by the moments of turning T. From then on
the moments of the event flow are added. Events change the normal force in a second way too: by the
increments of the recurrent network (`EventGains`).

A value y is what the latest frame shows plus the increments since the centre of its exposure. When
a frame has been evaluated, 25 times a second, y is corrected at once. A controller must not see
these steps, which are not steps of the real force. The output therefore follows a correction c over
the next :math:`N` windows, by an equal share in each:

.. math:: f_t = y_t - p_t, \quad p_{t+1} = p_t (1 - 1/n_t), \quad n_t = N, N-1, \dots, 1

where the pending part p grows by c and n starts over when a frame corrects. The standard deviation
of the output is

.. math:: \sigma^2 = b^2 + (s f)^2 + (h m)^2 + p^2

with a floor b, a share s of the value, and a share h of the motion m since the frame. The motion is
the change of the normal force by events, and for the others the sum of the absolute increments.
Sideways force and torsion hold for a gel of usual stiffness, times `shear.unit`, which
`mixtac_fger.fger_net.with_gain` changes.

Axes are in the contact frame: x to the right and y upwards in the image, z from the contact into
the gel (right-handed, REP-103). Forces act on the skin.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_fger.config import CELL_FEATURES, MOMENTS, PRESSES, TURNING_WIDTHS
from mixtac_fger.moments import PER_EVENT, along_flow, contact_of, moments_of_cells
from mixtac_fger.recurrent_network import advance, step_state, step_weights

if TYPE_CHECKING:
    from mixtac_fger.config import FgerConfig
    from mixtac_fger.weights import Tensors

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

NEWTONS: Final = (1.0, 1.0, 1e-3)
"""Units of the constants of sideways force and torsion: newtons, and newton millimetres."""


class Shear(NamedTuple):
    """Sideways force and torsion at the end of a window, in the contact frame.

    Attributes:
        x: Force on the skin to the right in the image [N].
        y: Upwards in the image [N].
        torque: Torque on the skin about z, from x to y [Nm].
        deviation: Standard deviation of the force per axis [N].
        torque_deviation: Of the torque [Nm].
    """

    x: float
    y: float
    torque: float
    deviation: float
    torque_deviation: float

    def scaled(self, gain: float) -> Shear:
        """Return the value of a sensor with a gain: the law is one for a pull and a torque."""
        return Shear._make(gain * each for each in self)


class EventGains:
    r"""How much force the events of this sensor stand for, measured with its frames.

    Events say in two ways by how much the force has changed: A is the sum of the increments of the
    network, and B is the press that their flow adds to the moments of the frame. A is the more
    accurate one on the kind of sensor that the network was trained on, and the only one in blows.
    B is linear and makes fewer errors on any other. From one frame to the next,

    .. math:: \Delta F = g_A A + g_B B,

    where F is the force of the frames. The gains are estimated by recursive least squares with the
    forgetting factor `KEPT` per frame. Contrast thresholds, gels and beads differ from sensor to
    sensor, and so do the gains. Noise events make A and B larger, which lowers the gains: events
    that explain nothing of what frames show count nothing. Blows are not used: their events
    saturate, and no frame shows them.

    Args:
        unit: What one newton of the constants is; see `FgerConfig.force_unit`.

    Attributes:
        value: Both gains, float64 [2].
    """

    PRIOR: Final = (0.8, 0.15)
    """The gains before any frame, and where frames and events say little."""
    PRIOR_N: Final = 0.3
    """Change of the force whose weight the prior has [N]."""
    KEPT: Final = 0.998
    """Share of the sums that is kept from frame to frame."""
    LARGEST: Final = 4.0
    """Largest gain."""
    LARGEST_N: Final = 1.0
    """Change from one frame to the next from which on there was a blow [N]."""

    def __init__(self, unit: float = 1.0) -> None:
        self._largest = unit * self.LARGEST_N
        self._prior = (unit * self.PRIOR_N) ** 2
        self.value = np.array(self.PRIOR)
        # The prior is left out: it must not fade.
        self._squares, self._products = np.zeros((2, 2)), np.zeros(2)
        self._before: tuple[float, F64] | None = None

    def forget_frame(self) -> None:
        """Restart with the next frame; the gains are kept: they belong to the sensor."""
        self._before = None

    def frame(self, force: float, sums: F64) -> None:
        """Add a frame.

        Args:
            force: Force of the frame [N].
            sums: Of A and B until the centre of its exposure [N], [2]; kept.
        """
        before, self._before = self._before, (force, sums)
        if before is None:
            return
        change, added = force - before[0], sums - before[1]
        if max(abs(change), abs(float(self.value @ added))) >= self._largest:
            return
        self._squares = self.KEPT * self._squares + np.outer(added, added)
        self._products = self.KEPT * self._products + change * added
        squares = self._squares + self._prior * np.eye(2)
        found = np.linalg.solve(squares, self._products + self._prior * np.array(self.PRIOR))
        self.value = np.clip(found, 0.0, self.LARGEST)


BLOW_N = 1.0
"""Range of the sum of increments around an exposure from which on there was a blow [N]."""
SETTLE_WINDOWS = 100
"""Windows after which the recurrent state has settled at a force."""


class Shown(NamedTuple):
    """What a frame shows.

    Attributes:
        feature: Moments over their spread, float32 [14].
        value: Normal force [N]; and where the model gives them, for a gel of usual stiffness,
            sideways force to the right and upwards [N] and torsion [N mm]; float64 [1 or 4].
        per_flow: Change of `value` by a flow of one pixel per contrast threshold, x and y, in each
            cell of the event grid; float64 [1 or 4, grid rows, grid columns, 2].
    """

    feature: F32
    value: F64
    per_flow: F64


def per_moment(tensors: Tensors) -> F64:
    """Return the constants of all values by moment over its spread, [1 or 4, `MOMENTS`].

    Args:
        tensors: Of a weight file.
    """
    found = np.zeros((4 if 'shear.pull' in tensors else 1, MOMENTS))
    found[0, :PRESSES] = tensors['frame.press']
    if len(found) > 1:
        for axis in range(2):
            found[1 + axis, [PRESSES + axis, PRESSES + 2 + axis]] = tensors['shear.pull']
        found[3, -len(TURNING_WIDTHS) :] = tensors['shear.turning']
    return found


@njit(cache=True, nogil=True)
def _add_flow(features: F32, per_flow: F64, before: F64, after: F64) -> None:
    """Write the sums by flow, and of their sizes, after a window, given those before it."""
    for axis in range(per_flow.shape[0]):
        increment = along_flow(features, per_flow[axis])
        after[1, axis] = before[1, axis] + increment
        after[2, axis] = before[2, axis] + abs(increment)


class ForcePath:
    """Normal force, sideways force and torsion with their state; memory is fixed.

    `measure` may be called from another thread than the rest.

    Args:
        config: Network configuration.
        tensors: Of its weight file; copied.

    Attributes:
        gains: How much normal force the events of this sensor stand for.
        known: Whether there was a frame since the start or `clear`.
        pending: What the output has yet to follow; as `Shown.value`.
    """

    def __init__(self, config: FgerConfig, tensors: Tensors) -> None:
        self._config, self._unit = config, config.force_unit
        self._spread, self._per_moment = np.array(tensors['frame.spread']), per_moment(tensors)
        # Of a displacement in bins.
        self._per_cell = PER_EVENT / config.frame_bin * self._per_moment / self._spread
        self._cells = np.empty((MOMENTS, *config.grid_shape, 2))
        self._weights = step_weights(tensors)
        self._state = step_state(self._weights)
        axes = len(self._per_moment)
        # Of the increments by the network (the normal force alone) and by flow, and of the sizes
        # of the latter, after each window.
        self._sums = np.zeros((config.history_windows, 3, axes))
        self._newest, self._then = 0, np.zeros((3, axes))
        self._value, self.pending, self._windows = np.zeros(axes), np.zeros(axes), 0
        units, shares = [1.0], [tensors['deviation']]
        if axes > 1:
            units += (tensors['shear.unit'] * NEWTONS).tolist()
            shares += [*tensors['shear.deviation']]
        self._units, self._shares = np.array(units), np.array(shares, np.float64).T
        self.known = False
        self.gains = EventGains(self._unit)
        self._per_flow = np.zeros((axes, *config.grid_shape, 2))

    def measure(self, moments: F32) -> Shown:
        """Return what a frame shows.

        Args:
            moments: Of `mixtac_fger.moments.moments`, float32 [14].
        """
        feature = np.asarray(moments / self._spread, np.float32)
        shape = self._config.frame_shape
        moments_of_cells(contact_of(moments, shape), shape, self._cells)
        per_flow = np.tensordot(self._per_cell, self._cells, 1)
        return Shown(feature, self._per_moment @ feature, per_flow)

    @property
    def moved(self) -> F64:
        """Changes since the exposure of the latest frame, by events; as `Shown.value`."""
        added = self._sums[self._newest] - self._then
        added[1, 0] = self.gains.value @ added[:2, 0]
        return np.asarray(added[1])

    @property
    def value(self) -> F64:
        """Present values, which the output follows; as `Shown.value`."""
        return self._value + self.moved

    def course(self) -> tuple[F64, F64]:
        """Return `value`, and how far it has moved by events since the latest frame.

        The latter is the change of the normal force, and the sum of the sizes of the increments of
        the others.
        """
        moved, travelled = self.moved, self._sums[self._newest, 2] - self._then[2]
        travelled[0] = moved[0]
        return self._value + moved, travelled

    def estimate(self) -> tuple[F64, F64]:
        """Return the output and its standard deviation after the latest window [N, N, N, Nm]."""
        value, travelled = self.course()
        output, (floor, share, drift) = value - self.pending, self._shares
        square = floor**2 + (share * output) ** 2 + (drift * travelled) ** 2 + self.pending**2
        return self._units * output, self._units * np.sqrt(square)

    def change_sensor(self) -> None:
        """Forget the gains of the events."""
        self.gains = EventGains(self._unit)

    def clear(self) -> None:
        """Reset all values and the memory; the gains of the events are kept."""
        self._state.hidden[:] = self._state.cell[:] = 0.0
        self.gains.forget_frame()
        self._sums[:] = self._then[:] = 0.0
        # New arrays: the value is of the frame, which keeps it.
        self._value, self.pending = np.zeros_like(self._value), np.zeros_like(self.pending)
        self._windows = 0
        self.known = False

    def start_at(self, shown: Shown) -> None:
        """Start at what a frame shows, with the memory of a rest at this force without events.

        With an empty memory, which fits no force, the next increments would be wrong.
        """
        self._see(shown)
        self.clear()
        self._value, self.known = shown.value, True
        still = np.zeros((*self._config.grid_shape, CELL_FEATURES), np.float32)
        for _ in range(SETTLE_WINDOWS):
            advance(still, shown.value[0], self._weights, self._state)

    def correct(self, shown: Shown, lag: int, windows: int = 1) -> None:
        """Correct all values by a frame.

        Args:
            shown: What it shows.
            lag: Windows between the last estimate and the centre of its exposure.
            windows: Windows in which the output follows.
        """
        before = self.value
        place = (self._newest - min(max(lag, 0), len(self._sums) - 1)) % len(self._sums)
        self._value, self._then = shown.value, self._sums[place].copy()
        self.gains.frame(float(shown.value[0]), self._then[:2, 0])
        change = self.value - before
        if not self.known:
            # There was no sideways force before.
            change[1:] = 0.0
        self.pending, self._windows, self.known = self.pending + change, windows, True
        self._see(shown)

    def _see(self, shown: Shown) -> None:
        """Relate motion and force by a frame from now on."""
        weights = self._weights
        self._state.context[:] = weights.increment_hidden_bias + weights.context @ shown.feature
        self._per_flow = shown.per_flow

    def blow(self, lag: int, half: int) -> bool:
        """Return whether past windows are part of a blow, which no frame shows.

        Args:
            lag: Windows between the last estimate and their middle.
            half: Windows before and after the middle; fewer if later windows do not exist yet.
        """
        middle = self._newest - min(lag, len(self._sums) - half - 2)
        places = np.arange(middle - half - 1, min(middle + half, self._newest) + 1)
        sums = self._sums[:, 0, 0].take(places, mode='wrap')
        return bool(np.ptp(sums) > self._unit * BLOW_N)

    def step(self, features: F32) -> None:
        """Advance by one window.

        Args:
            features: Grid features, float32 [grid rows, grid columns, 4].
        """
        before, self._newest = self._sums[self._newest], (self._newest + 1) % len(self._sums)
        after = self._sums[self._newest]
        # The network has learned with its own increments.
        force = self._value[0] + before[0, 0] - self._then[0, 0]
        after[0, 0] = before[0, 0] + advance(features, force, self._weights, self._state)
        _add_flow(features, self._per_flow, before, after)
        if self._windows:
            self.pending = self.pending - self.pending / self._windows
            self._windows -= 1
