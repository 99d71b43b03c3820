# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Features of event windows: counts, and the motion of the skin with the help of the latest frame.

A bead edge that moves by u changes the log intensity by -g u, where g is its gradient; each event
reports one contrast threshold of that change with its sign. Sums of sign times gradient over a
window, weighted with the possible motion fields, therefore give the motion by least squares. Two
kinds of motion are separated: translation of the skin around the contact, which slip causes, and
motion away from the centre of the contact, which pressing causes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.frames import bin_mean, gradients, log_contrast
from mixtac_core.events.windows import WindowSlicer
from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.parameters import WINDOW_US, SlipControlParameters

BIN: Final = 2
"""Pixels along a bin of the gradient: bead edges are wider, and noise is halved."""
LOG_FLOOR: Final = 0.05
"""Added to the relative intensity before the logarithm, so that dark pixels count little."""
RIDGE: Final = 1e-3
"""Regularisation over the mean of the normal matrix' diagonal."""
LEAST_MOVE_PX: Final = 4.0
"""Distance by which a contact has to move to be followed [px]: less changes no weight by 5 %."""
MODES: Final = 3
"""Translation along x and y, and pressing."""
REACH_SHARE: Final = 9.0 / 26.0
"""Distance from the contact at which its weight is 1/e, over the shorter side of the image."""


@dataclass(frozen=True, slots=True, eq=False)
class FlowGuide:
    """One frame, ready for event windows.

    Attributes:
        fields: What an event of either sign adds to the sums, float32 [3, rows, columns] of bins.
        solver: Times the negative sums it gives translation at the contact and pressing at its
            reach [px per contrast threshold], float64 [3, 3].
        frame_us: Centre of the frame's exposure, camera clock [us].
        contrast: Root mean square gradient of the log intensity at the contact [1/px].
    """

    fields: NDArray[np.float32]
    solver: NDArray[np.float64]
    frame_us: int
    contrast: float


class GuideMaker:
    """Makes guides of frames; holds scratch memory, so one per thread.

    The size of the sensor is that of the frames.

    Args:
        parameters: Where the contact is in the image.

    Attributes:
        centre: Column and row of the contact [px] where the parameters give none; None: the middle.
    """

    def __init__(self, parameters: SlipControlParameters) -> None:
        self.parameters = parameters
        self._made_for: tuple[Any, Any] | None = None
        self.centre: tuple[float, float] | None = None

    def make(self, image: NDArray[np.uint8] | NDArray[np.uint16], frame_us: int) -> FlowGuide:
        """Return the guide of a frame.

        Args:
            image: Intensity [height, width], any number of bits.
            frame_us: Centre of its exposure, camera clock [us].

        Raises:
            SlipControlError: An image that is too small or has more than one channel.
        """
        if (image.shape, self.centre) != self._made_for:
            self._resize(image.shape)
        binned, logs, along_x, along_y = self._work
        bin_mean(image, BIN, binned)
        log_contrast(binned, LOG_FLOOR, logs)
        gradients(logs, BIN, along_x, along_y)
        fields = np.empty((MODES, *binned.shape), np.float32)
        np.multiply(along_x, self._weight, out=fields[0])
        np.multiply(along_y, self._weight, out=fields[1])
        np.multiply(fields[0], self._away_x, out=fields[2])
        fields[2] += fields[1] * self._away_y
        squares = float(np.vdot(fields[:2], fields[:2]))
        # A contact outside of the image has no weight in it.
        contrast = math.sqrt(0.5 * squares / max(self._weight_squares, 1e-12))
        solver = _solver(fields)
        return FlowGuide(fields, solver, int(frame_us), contrast)

    def _resize(self, size: tuple[int, ...]) -> None:
        """Make scratch memory and the geometry of the contact for images [height, width]."""
        if len(size) != 2 or min(size) < 4 * BIN:
            raise SlipControlError(
                f'image of shape {size}: slip control needs grey images of at least '
                f'{4 * BIN} x {4 * BIN} pixels'
            )
        height, width = size
        shape = (height // BIN, width // BIN)
        centre = self.parameters.contact_place or self.centre
        column, row = centre or (width / 2.0, height / 2.0)
        reach = REACH_SHARE * min(size)
        across = (BIN * np.arange(shape[1]) + 0.5 * (BIN - 1) - column) / reach
        down = (BIN * np.arange(shape[0]) + 0.5 * (BIN - 1) - row) / reach
        away_x, away_y = np.meshgrid(across, down)
        weight = np.exp(-(away_x**2 + away_y**2))
        self._away_x, self._away_y = away_x.astype(np.float32), away_y.astype(np.float32)
        self._weight = weight.astype(np.float32)
        self._weight_squares = float(np.sum(weight**2))
        self._work = [np.empty(shape, np.float32) for _ in range(4)]
        self._made_for = (size, self.centre)


def _solver(fields: NDArray[np.float32]) -> NDArray[np.float64]:
    flat = fields.reshape(MODES, -1)
    normal = BIN * BIN * np.asarray(flat @ flat.T, np.float64)
    # A frame without any contrast guides nothing: its solver gives zero for zero sums.
    ridge = max(RIDGE * np.trace(normal) / MODES, 1e-12)
    return np.asarray(np.linalg.inv(normal + ridge * np.eye(MODES)), np.float64)


@njit(cache=True, nogil=True)
def window_sums(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    polarity: NDArray[np.bool_],
    fields: NDArray[np.float32],
    bin_size: int,
    sums: NDArray[np.float64],
    squares: NDArray[np.float64],
) -> None:
    """Write sums of the fields over some events; events outside are left out.

    Args:
        x: Columns, uint16 [n].
        y: Rows, uint16 [n].
        polarity: True where brighter, bool [n].
        fields: Of a `FlowGuide`, float32 [modes, rows, columns] of bins.
        bin_size: Pixels along a bin.
        sums: Written: of sign times field, float64 [modes].
        squares: Written: of the fields squared, float64 [modes].
    """
    modes, rows, columns = fields.shape
    sums[:] = 0.0
    squares[:] = 0.0
    for index in range(x.shape[0]):
        row, column = y[index] // bin_size, x[index] // bin_size
        if row >= rows or column >= columns:
            continue
        sign = 1.0 if polarity[index] else -1.0
        for mode in range(modes):
            value = fields[mode, row, column]
            sums[mode] += sign * value
            squares[mode] += value * value


MAX_EMPTY_RUN: Final = 20
"""Most empty windows that are returned after a gap; older ones are skipped."""
STALE_GUIDE_US: Final = 500_000
"""A frame older than this is not used."""
LIGHT_EVENTS: Final = 400
"""Fewest events of a window that can show a change of light."""
LIGHT_SHARE: Final = 0.8
"""Ratio of one sign to the other from which events are attributed to light; motion causes both."""


@dataclass(frozen=True, slots=True)
class SlipWindow:
    """One counting window.

    Attributes:
        end_us: Its end, camera clock [us].
        count: Events in it.
        flow_x: Translation of the skin at the contact to the right [px per contrast threshold].
        flow_y: Translation of the skin at the contact downwards, same unit.
        pressing: Motion away from the contact, at its reach, same unit.
        guided: Whether a recent frame was there to measure motion with; else the motions are 0.
        complete: False where packets of the window were lost.
        light: Whether its events come from a change of light.
        noise: Mean square of the translation that as many events at the same places would give with
            signs at random; the unit of `flow_x`, squared.
    """

    end_us: int
    count: int
    flow_x: float
    flow_y: float
    pressing: float
    guided: bool
    complete: bool
    light: bool = False
    noise: float = 0.0


class SlipFeatures:
    """Cuts an event stream into windows and computes their features.

    Args:
        parameters: Where the contact is in the image.

    Attributes:
        slicer: Counts what was late, skipped or restarted.
    """

    def __init__(self, parameters: SlipControlParameters) -> None:
        self.slicer = WindowSlicer(WINDOW_US, max_empty_run=MAX_EMPTY_RUN)
        self._maker = GuideMaker(parameters)
        self._guide: FlowGuide | None = None
        self._size: tuple[int, int] | None = None
        # Without a frame every event lies outside the fields, and the sums stay 0.
        self._blank = np.zeros((MODES, 1, 1), np.float32)
        self._sums, self._squares = np.zeros(MODES), np.zeros(MODES)
        self._lost_until_us = 0

    @property
    def contrast(self) -> float:
        """Contrast of the latest frame at the contact [1/px]; NaN before the first."""
        return self._guide.contrast if self._guide is not None else math.nan

    def warm_up(self) -> None:
        """Compile (or load) the kernels, for frames of 8 and of 16 bits."""
        none16, none = np.empty(0, np.uint16), np.empty(0, np.bool_)
        window_sums(none16, none16, none, self._blank, BIN, self._sums, self._squares)
        maker = GuideMaker(self._maker.parameters)
        maker.make(np.ones((4 * BIN, 4 * BIN), np.uint8), 0)
        maker.make(np.ones((4 * BIN, 4 * BIN), np.uint16), 0)

    def resize(self, width: int, height: int) -> None:
        """Set the size of the sensor, as its event packets state it."""
        if self._size != (height, width):
            self._size = (height, width)
            self._guide = None

    def frame(self, image: NDArray[np.uint8] | NDArray[np.uint16], frame_us: int) -> None:
        """Measure motion by a frame from now on.

        Args:
            image: Intensity [height, width], any number of bits.
            frame_us: Centre of its exposure, camera clock [us].

        Raises:
            SlipControlError: Too small, or of another size than the events.
        """
        if self._size is not None and image.shape != self._size:
            raise SlipControlError(
                f'frames of shape {image.shape}, events of a sensor of {self._size} rows and '
                'columns: set the camera to full resolution'
            )
        self._guide = self._maker.make(image, frame_us)

    def contact_at(self, column: float, row: float) -> None:
        """Set where the contact is in the image [px], unless the parameters do.

        The next frame uses it. A place outside of the image is ignored.
        """
        height, width = self._size or (0, 0)
        before = self._maker.centre
        moved = before is None or math.dist(before, (column, row)) > LEAST_MOVE_PX
        if moved and 0.0 <= column < width and 0.0 <= row < height:
            self._maker.centre = (column, row)

    def lost_before(self, time_us: int) -> None:
        """Note that events before a time (camera clock [us]) are missing."""
        self._lost_until_us = time_us

    def push(self, events: Events, complete_until: int) -> list[SlipWindow]:
        """Add the next events and return the windows that they close, in order.

        Args:
            events: Camera clock [us]; may be empty.
            complete_until: Camera clock [us]: no event before this time will follow.
        """
        return [
            self._features(end_us, window)
            for end_us, window in self.slicer.push(events, complete_until)
        ]

    def _features(self, end_us: int, events: Events) -> SlipWindow:
        guide = self._guide
        fresh = guide is not None and abs(end_us - guide.frame_us) <= STALE_GUIDE_US
        fields = guide.fields if guide is not None and fresh else self._blank
        places = events.x, events.y, events.polarity
        window_sums(*places, fields, BIN, self._sums, self._squares)
        one_sign = abs(2 * int(np.count_nonzero(events.polarity)) - len(events))
        motion, noise = self._sums, 0.0
        if guide is not None and fresh:
            motion = -(guide.solver @ self._sums)
            noises = guide.solver**2 @ self._squares
            noise = float(noises[0] + noises[1])
        return SlipWindow(
            end_us=end_us,
            count=len(events),
            flow_x=float(motion[0]),
            flow_y=float(motion[1]),
            pressing=float(motion[2]),
            guided=fresh,
            complete=end_us - self.slicer.width_us >= self._lost_until_us,
            light=one_sign >= LIGHT_SHARE * max(len(events), LIGHT_EVENTS),
            noise=noise,
        )
