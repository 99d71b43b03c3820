# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Features of event windows: counts, and the motion of the skin with the help of the latest frame.

A bead edge that moves by u changes the log intensity by -g u, where g is its gradient; each event
reports one contrast threshold of that change with its sign. Sums of sign times gradient over a
window, weighted with the fields that the motion may have, therefore give the motion by least
squares. Two kinds of motion are separated: translation of the skin around the contact, which slip
makes, and motion away from the centre of the contact, which pressing makes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numba import njit

from mixtac_events.frames import bin_mean, gradients, log_contrast
from mixtac_events.windows import WindowSlicer
from mixtac_slip_control.errors import SlipControlError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_events.arrays import Events


BIN: Final = 2
"""Pixels along a bin of the gradient: bead edges are wider, and noise is halved."""
LOG_FLOOR: Final = 0.05
"""Added to the relative intensity before the logarithm: dark pixels say little."""
RIDGE: Final = 1e-3
"""Regularisation over the mean of the normal matrix' diagonal."""
MODES: Final = 3
"""Translation along x and y, and pressing."""


@dataclass(frozen=True, slots=True)
class GuideSettings:
    """The fields of motion.

    Attributes:
        width: Columns of the sensor.
        height: Rows.
        centre_px: Contact, column and row; None for the middle of the array.
        reach_px: Distance from the contact over which motion falls to 1/e.
    """

    width: int = 346
    height: int = 260
    centre_px: tuple[float, float] | None = None
    reach_px: float = 90.0

    def __post_init__(self) -> None:
        """Refuse sizes without a meaning.

        Raises:
            SlipControlError: A size or reach that is not positive.
        """
        if min(self.width, self.height) < 4 * BIN or not self.reach_px > 0.0:
            raise SlipControlError(
                f'sensor of {self.width} x {self.height} px, reach {self.reach_px:g} px: give the '
                'size of the camera and a positive reach'
            )


@dataclass(frozen=True, slots=True, eq=False)
class FlowGuide:
    """One frame, ready for event windows.

    Attributes:
        fields: What an event of either sign adds to the sums, float32 [3, rows, columns] of bins.
        solver: Inverse of the regularised normal matrix, float64 [3, 3]; times the negative sums
            it gives motion at the contact [px per contrast threshold].
        frame_us: Centre of the frame's exposure, camera clock [us].
    """

    fields: NDArray[np.float32]
    solver: NDArray[np.float64]
    frame_us: int


class GuideMaker:
    """Makes guides of frames; holds scratch memory, so one per thread.

    Args:
        settings: The fields of motion.
    """

    def __init__(self, settings: GuideSettings | None = None) -> None:
        self._settings = settings or GuideSettings()
        self._shape = (self._settings.height // BIN, self._settings.width // BIN)
        self._work = [np.empty(self._shape, np.float32) for _ in range(4)]
        self._away_x, self._away_y, self._weight = _geometry(self._settings, self._shape)

    def make(self, image: NDArray[np.uint8] | NDArray[np.uint16], frame_us: int) -> FlowGuide:
        """Return the guide of a frame.

        Args:
            image: Intensity [height, width], any number of bits.
            frame_us: Centre of its exposure, camera clock [us].

        Raises:
            SlipControlError: Another size than the sensor's.
        """
        expected = (self._settings.height, self._settings.width)
        if image.shape != expected:
            raise SlipControlError(
                f'image of shape {image.shape}: slip control reads {expected}; set the camera to '
                'full resolution'
            )
        binned, logs, along_x, along_y = self._work
        bin_mean(image, BIN, binned)
        log_contrast(binned, LOG_FLOOR, logs)
        gradients(logs, BIN, along_x, along_y)
        fields = np.empty((MODES, *self._shape), np.float32)
        np.multiply(along_x, self._weight, out=fields[0])
        np.multiply(along_y, self._weight, out=fields[1])
        np.multiply(fields[0], self._away_x, out=fields[2])
        fields[2] += fields[1] * self._away_y
        return FlowGuide(fields, _solver(fields), int(frame_us))


def _geometry(
    settings: GuideSettings, shape: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return the way from the contact along x and y over the reach, and the weight, per bin."""
    column, row = settings.centre_px or (settings.width / 2.0, settings.height / 2.0)
    across = (BIN * np.arange(shape[1]) + 0.5 * (BIN - 1) - column) / settings.reach_px
    down = (BIN * np.arange(shape[0]) + 0.5 * (BIN - 1) - row) / settings.reach_px
    away_x, away_y = np.meshgrid(across, down)
    weight = np.exp(-(away_x**2 + away_y**2))
    return (
        away_x.astype(np.float32),
        away_y.astype(np.float32),
        weight.astype(np.float32),
    )


def _solver(fields: NDArray[np.float32]) -> NDArray[np.float64]:
    flat = fields.reshape(MODES, -1)
    normal = BIN * BIN * np.asarray(flat @ flat.T, np.float64)
    ridge = RIDGE * np.trace(normal) / MODES
    # A frame without any contrast guides nothing: its solver gives zero for zero sums.
    return np.linalg.inv(normal + max(ridge, 1e-12) * np.eye(MODES))


@njit(cache=True, nogil=True)
def window_sums(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    polarity: NDArray[np.bool_],
    fields: NDArray[np.float32],
    bin_size: int,
    sums: NDArray[np.float64],
) -> int:
    """Write the signed sums of the fields over some events; events outside are left out.

    Args:
        x: Columns, uint16 [n].
        y: Rows, uint16 [n].
        polarity: True where brighter, bool [n].
        fields: Of a `FlowGuide`, float32 [modes, rows, columns] of bins.
        bin_size: Pixels along a bin.
        sums: Written, float64 [modes].

    Returns:
        Number of ON events.
    """
    modes, rows, columns = fields.shape
    on = 0
    sums[:] = 0.0
    for index in range(x.shape[0]):
        brighter = polarity[index]
        on += brighter
        row, column = y[index] // bin_size, x[index] // bin_size
        if row >= rows or column >= columns:
            continue
        sign = 1.0 if brighter else -1.0
        for mode in range(modes):
            sums[mode] += sign * fields[mode, row, column]
    return on


MAX_EMPTY_RUN: Final = 20
"""After a gap only this many empty windows are handed out: old news helps nobody."""
STALE_GUIDE_US: Final = 500_000
"""A frame older than this guides no more."""


@dataclass(frozen=True, slots=True)
class SlipWindow:
    """One counting window.

    Attributes:
        end_us: Its end, camera clock [us].
        count: Events in it.
        on: ON events in it.
        flow_x: Translation of the skin at the contact to the right [px per contrast threshold].
        flow_y: The same downwards.
        pressing: Motion away from the contact, at the reach of the guide, same unit.
        guided: Whether a frame was there to tell motion by; else the three above are 0.
        complete: False where packets of the window were lost.
    """

    end_us: int
    count: int
    on: int
    flow_x: float
    flow_y: float
    pressing: float
    guided: bool
    complete: bool


class SlipFeatures:
    """Cuts an event stream into windows and computes their features.

    Args:
        window_us: Width of a window [us].
        settings: Of the guides that will come.

    Attributes:
        slicer: Counts what was late, skipped or restarted.
    """

    def __init__(self, window_us: int = 1000, settings: GuideSettings | None = None) -> None:
        shape = settings or GuideSettings()
        self.slicer = WindowSlicer(window_us, max_empty_run=MAX_EMPTY_RUN)
        self._guide: FlowGuide | None = None
        self._blank = np.zeros((MODES, shape.height // BIN, shape.width // BIN), np.float32)
        self._sums = np.zeros(MODES)
        self._lost_until_us = 0
        self.warm_up()

    def warm_up(self) -> None:
        """Compile (or load) the kernel."""
        none16, none = np.empty(0, np.uint16), np.empty(0, np.bool_)
        window_sums(none16, none16, none, self._blank, BIN, self._sums)

    def guide(self, guide: FlowGuide | None) -> None:
        """Use a frame's guide from now on; None goes on without."""
        self._guide = guide

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
        on = window_sums(events.x, events.y, events.polarity, fields, BIN, self._sums)
        motion = -(guide.solver @ self._sums) if guide is not None and fresh else self._sums
        return SlipWindow(
            end_us=end_us,
            count=len(events),
            on=int(on),
            flow_x=float(motion[0]),
            flow_y=float(motion[1]),
            pressing=float(motion[2]),
            guided=fresh,
            complete=end_us - self.slicer.width_us >= self._lost_until_us,
        )
