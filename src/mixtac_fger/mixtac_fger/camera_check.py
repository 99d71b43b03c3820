# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whether a model and the camera in front of it belong together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mixtac_fger.errors import ModelError

if TYPE_CHECKING:
    from mixtac_fger.weights import LoadedModel

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
