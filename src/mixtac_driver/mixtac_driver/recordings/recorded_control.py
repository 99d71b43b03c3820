# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The control of a camera that is not there any more."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixtac_driver.camera_control import CameraControl
from mixtac_driver.configuration import Configuration
from mixtac_driver.errors import RecordingError

if TYPE_CHECKING:
    from mixtac_driver.sequences import Origin


class RecordedControl(CameraControl):
    """Takes settings, which change nothing, and refuses requests.

    Args:
        device: Path of the recording.
    """

    def __init__(self, device: str) -> None:
        super().__init__(Configuration())
        self._device = device

    def request_frame(self) -> None:
        """Refuse.

        Raises:
            RecordingError: Always.
        """
        raise self._refusal('take a frame')

    def reset_timestamps(self) -> Origin:
        """Refuse.

        Raises:
            RecordingError: Always.
        """
        raise self._refusal('reset its clock')

    def _refusal(self, request: str) -> RecordingError:
        return RecordingError(f'{self._device} is a recording: no camera is there to {request}')
