# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Contact and displacement as messages, in the contact frame, in metres; without their headers."""

from __future__ import annotations

import array
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mixtac_fger.contact_tracking import Contact
from mixtac_fger.displacement import DisplacementField, SkinScale, field_places

F32 = NDArray[np.float32]
MM: Final = 1e-3
CLOUD_FIELDS: Final = ('x', 'y', 'z', 'dx', 'dy', 'confidence')
FLOAT32: Final = 7
"""`sensor_msgs/PointField.FLOAT32`."""


def fill_contact(
    message: Any,  # noqa: ANN401
    contact: Contact,
    frame_age_us: int,
    scale: SkinScale,
    size: tuple[int, int],
) -> None:
    """Write everything but the header of a `mixtac_msgs/Contact`.

    Args:
        message: Written to.
        contact: What is written.
        frame_age_us: From the centre of the latest frame's exposure to the stamp [us].
        scale: Of the skin in the picture.
        size: Columns and rows of the camera's image [px].
    """
    shape = contact.shape
    message.in_contact, message.located = contact.touching, shape is not None
    message.frame_age = frame_age_us * 1e-6
    if shape is None:
        return
    fill_point(message.position, contact)
    message.position_deviation = shape.deviation_mm * MM
    message.area = shape.area_mm2 * MM**2
    message.area_deviation = shape.area_deviation_mm2 * MM**2
    message.major, message.minor = shape.major_mm * MM, shape.minor_mm * MM
    message.angle = shape.angle
    column, row = scale.axis(*size)
    message.column = column + shape.x_mm * scale.px_per_mm
    message.row = row - shape.y_mm * scale.px_per_mm
    message.scale = scale.px_per_mm / MM


def fill_point(point: Any, contact: Contact) -> None:  # noqa: ANN401
    """Write the place of a located contact to a `geometry_msgs/Point`."""
    assert contact.shape is not None  # noqa: S101  (the caller has looked)
    point.x, point.y, point.z = contact.shape.x_mm * MM, contact.shape.y_mm * MM, 0.0


def metric(moved: F32, scale: SkinScale) -> F32:
    """Return a displacement in the image [2, rows, columns] [px] in the contact frame [m]."""
    per_px = MM / scale.px_per_mm
    signs = np.array([per_px, -per_px], np.float32)[:, None, None]
    return np.asarray(moved * signs, np.float32)


def fill_field(message: Any, moved: F32) -> None:  # noqa: ANN401
    """Write a displacement [m] to a `sensor_msgs/Image` as 32FC2; rows as in the camera's image."""
    message.height, message.width = moved.shape[1:]
    message.encoding, message.is_bigendian = '32FC2', 0
    message.step = 8 * moved.shape[2]
    message.data = array.array('B', np.ascontiguousarray(moved.transpose(1, 2, 0)).tobytes())


def fill_cloud(
    message: Any,  # noqa: ANN401
    moved: F32,
    field: DisplacementField,
    scale: SkinScale,
    size: tuple[int, int],
    point_field: Any,  # noqa: ANN401
) -> None:
    """Write a displacement to a `sensor_msgs/PointCloud2` with the fields `CLOUD_FIELDS`.

    Args:
        message: Written to.
        moved: Displacement [m], float32 [2, rows, columns].
        field: Whose places and confidence.
        scale: Of the skin in the picture.
        size: Columns and rows of the camera's image [px].
        point_field: The class `sensor_msgs.msg.PointField`.
    """
    shape = moved.shape[1], moved.shape[2]
    places = MM * field_places(shape, field.spacing_px, scale, size)
    flat = np.zeros_like(places[:1])
    points = np.concatenate([places, flat, moved, field.confidence()[None]])
    message.height, message.width = shape
    message.fields = [
        point_field(name=name, offset=4 * index, datatype=FLOAT32, count=1)
        for index, name in enumerate(CLOUD_FIELDS)
    ]
    message.point_step = 4 * len(CLOUD_FIELDS)
    message.row_step, message.is_dense = message.point_step * shape[1], True
    data = np.ascontiguousarray(points.transpose(1, 2, 0), np.float32)
    message.data = array.array('B', data.tobytes())
