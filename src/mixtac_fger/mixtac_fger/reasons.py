# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Why a force cannot be trusted, by number and in words."""

from __future__ import annotations

from enum import IntEnum


class Reason(IntEnum):
    """Why a force cannot be trusted; the numbers are those of `mixtac_msgs/ForceQuality`."""

    TRUSTED = 0
    PICTURE_UNLIKE_REFERENCE = 1
    LIGHT_CHANGED = 2
    FRAME_FROZEN = 3
    EVENTS_MISSING = 4
    EVENTS_WITHOUT_MOTION = 5
    EVENTS_DISAGREE = 6
    CAMERA_MOVED = 7
    OTHER_CAMERA = 8
    ZERO_UNKNOWN = 9
    OUT_OF_RANGE = 10
    SATURATED = 11
    STALE = 12

    @property
    def text(self) -> str:
        """One line for people, with what to do."""
        return TEXTS[self]


TEXTS = {
    Reason.TRUSTED: 'trusted',
    Reason.PICTURE_UNLIKE_REFERENCE: 'the picture is not that of the reference under any contact:'
    ' look at the image; after a change of the gel release the sensor and call ~/tare',
    Reason.LIGHT_CHANGED: 'the light changed beyond what contact explains: check the LEDs, then'
    ' release the sensor and call ~/tare',
    Reason.FRAME_FROZEN: 'the camera sends the same frames again and again: restart the driver',
    Reason.EVENTS_MISSING: 'there are no events, or fewer than at rest, or they pause: check the'
    ' biases and restart the driver; if so few are right, release the sensor and call ~/tare',
    Reason.EVENTS_WITHOUT_MOTION: 'there are many events although the frames do not move: check'
    ' for hot pixels, flicker and biases; if so many are right, release the sensor and call ~/tare',
    Reason.EVENTS_DISAGREE: 'events and frames tell of different motions, or the same events come'
    ' again and again, or many have the same time, or their noise is not that of the pixels: check'
    ' that both are of the same camera, have its times, and are neither mirrored nor late; after a'
    ' change of biases release the sensor and call ~/tare',
    Reason.CAMERA_MOVED: 'the whole picture has moved against the reference: fix the camera,'
    ' release the sensor and call ~/tare',
    Reason.OTHER_CAMERA: 'another camera was connected: release the sensor and call ~/tare',
    Reason.ZERO_UNKNOWN: 'the zero is unknown: touch the sensor, release it and call ~/tare, or set'
    ' assume_free if nothing touched it at the start',
    Reason.OUT_OF_RANGE: 'the force is outside of what the model was trained on',
    Reason.SATURATED: 'the sensor sent more events than it can, until the next frame',
    Reason.STALE: 'the latest frame is too old',
}
