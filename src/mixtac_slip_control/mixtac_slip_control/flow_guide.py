# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the latest frame says of how motion would make events.

A bead edge that moves by u changes the log intensity by -g u, g its gradient; each event reports
one contrast threshold of that change with its sign. Sums of sign times gradient over a window,
weighted with the fields that motion may have, so give the motion by least squares. Two fields are
told apart: translation of the skin around the contact, which slip makes, and motion away from the
contact's centre, which pressing makes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_fger.frame_kernels import bin_mean, gradients, log_contrast
from mixtac_slip_control.errors import SlipControlError

if TYPE_CHECKING:
    from numpy.typing import NDArray

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
