# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What an estimator gives, what it reports, and which camera its model was made for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from mixtac_fger.config import ModelError

if TYPE_CHECKING:
    from mixtac_fger.weights import LoadedModel


class Estimate(NamedTuple):
    """The force at the end of a window, and how far it can be trusted.

    Attributes:
        end_us: End of the window, camera clock [us].
        force: Normal force [N].
        deviation: Standard deviation of it [N]; None of a model that gives none.
        frame_age_us: From the centre of the latest frame's exposure to the end of the window [us].
        complete: All packets of the window arrived.
        saturated: So many events that the sensor's readout is likely to have lost some.
    """

    end_us: int
    force: float
    deviation: float | None = None
    frame_age_us: int = 0
    complete: bool = True
    saturated: bool = False


@dataclass(frozen=True, slots=True)
class EstimatorStatus:
    """What the estimator says of itself.

    Attributes:
        ready: Whether windows give forces now.
        reason: Why not; empty when ready.
        windows: Windows closed so far.
        estimates: Forces given so far.
        withheld: Windows without a force although there was an estimate: no packet told of them, or
            the latest frame was too old.
        incomplete: Forces of windows of which a part of the packets is missing.
        saturated: Windows with so many events that the sensor is likely to have lost some.
        frames: Frames applied so far.
        frames_dropped: Frames replaced by a newer one before they were encoded or applied.
        frames_off_clock: Frames not used as their exposure is not near the time of the events.
        bad_frames: Frames of a size that the model does not read (background only).
        gaps: Holes in the stream.
        skipped_windows: Windows in holes so long that the estimate began anew.
        late_events: Events dropped since their window was closed.
        resets: Times the clock went backwards or the state was not finite.
        frame_age_us: Camera time since the centre of the latest frame's exposure, -1 without one.
        frame_force: Frames-only force of the latest frame [N].
        deviation: Standard deviation of the latest force [N], -1 of a model that gives none.
    """

    ready: bool
    reason: str
    windows: int
    estimates: int
    withheld: int
    incomplete: int
    saturated: int
    frames: int
    frames_dropped: int
    frames_off_clock: int
    bad_frames: int
    gaps: int
    skipped_windows: int
    late_events: int
    resets: int
    frame_age_us: int
    frame_force: float
    deviation: float


SERIAL_KEY = 'sensor_serial'
"""In `ModelCard.training` of a model that was adapted to one sensor: the camera's serial number."""


@dataclass(frozen=True, slots=True)
class CameraFacts:
    """What a camera says of itself.

    Attributes:
        width: Columns of its frames [px]; 0 while unknown.
        height: Rows [px].
        cut: Whether it sends a region or binned pixels only.
        serial: Serial number, empty while unknown.
    """

    width: int = 0
    height: int = 0
    cut: bool = False
    serial: str = ''


def check_camera(model: LoadedModel, camera: CameraFacts) -> None:
    """Refuse a camera that the model was not made for; what is unknown is not judged.

    Raises:
        ModelError: Size, region or serial number do not fit.
    """
    config = model.config
    wanted = (config.width, config.height)
    if camera.width and (camera.width, camera.height) != wanted:
        raise ModelError(
            f'the camera has {camera.width} x {camera.height} pixels, the model reads'
            f' {wanted[0]} x {wanted[1]}: choose a model of this size'
        )
    if camera.cut:
        raise ModelError(
            'the camera sends binned pixels or a region only: set it to full resolution'
        )
    serial = str(model.card.training.get(SERIAL_KEY, ''))
    if serial and camera.serial and serial != camera.serial:
        raise ModelError(
            f'the model was adapted to sensor {serial}, the camera is {camera.serial}: adapt one'
            ' to it with "mixtac adapt", or choose a general model'
        )
