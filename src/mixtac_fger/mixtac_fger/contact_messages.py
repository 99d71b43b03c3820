# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Publishers of contact and displacement: messages in the contact frame, in metres."""

from __future__ import annotations

import array
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from geometry_msgs.msg import Point, PointStamped
from numpy.typing import NDArray
from sensor_msgs.msg import Image, PointCloud2, PointField

from mixtac_core.node import topics
from mixtac_core.recordings.messages import set_header
from mixtac_fger.displacement import field_places
from mixtac_msgs.msg import Contact

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mixtac_fger.contact import ContactShape
    from mixtac_fger.contact_tracking import ContactSettings
    from mixtac_fger.displacement import DisplacementField, SkinScale
    from mixtac_fger.estimator import Estimate
    from mixtac_fger.parameters import FgerParameters
    from mixtac_fger.streaming import ForceEstimator

F32 = NDArray[np.float32]
MM: Final = 1e-3
CLOUD_FIELDS: Final = ('x', 'y', 'z', 'dx', 'dy', 'confidence')


class ContactOutputs:
    """Publishers of the topics of contact and displacement that the parameters ask for.

    Args:
        node: An rclpy lifecycle node of `mixtac_core.node.base_node`.
        settings: Its parameters.
    """

    def __init__(self, node: Any, settings: FgerParameters) -> None:  # noqa: ANN401
        self._node, self._field_us = node, 0
        chosen: tuple[topics.Topic, ...] = ()
        if settings.contact or settings.displacement != 'off':
            chosen = topics.CONTACT, topics.CONTACT_POINT
        if settings.displacement != 'off':
            chosen += topics.DISPLACEMENT, topics.DISPLACEMENT_POINTS
        self._publishers = {each: node.publish_topic(each, managed=True) for each in chosen}

    def close(self) -> None:
        """Destroy the publishers."""
        for publisher in self._publishers.values():
            self._node.destroy_lifecycle_publisher(publisher)

    def publish(
        self,
        estimator: ForceEstimator,
        estimates: Sequence[Estimate],
        settings: FgerParameters,
        found_by: ContactSettings,
    ) -> None:
        """Publish contact and displacement of estimates; not computed without a subscriber.

        Args:
            estimator: Gave the estimates.
            estimates: Estimates of the latest windows; at least one.
            settings: Parameters of the node.
            found_by: How contacts are found.
        """
        used = {
            topic: publisher
            for topic, publisher in self._publishers.items()
            if publisher.get_subscription_count()
        }
        estimator.use_contact(found_by if used else None)
        tracker = estimator.contact
        if tracker is None:
            return
        scale, size, frame_id = found_by.scale, estimator.size, settings.frame_id
        for estimate in estimates:
            contact = estimate.contact
            if contact is not None and topics.CONTACT in used:
                message = set_header(Contact(), 1000 * estimate.end_us, frame_id)
                message.in_contact, message.located = contact.touching, contact.shape is not None
                message.frame_age = estimate.frame_age_us * 1e-6
                if contact.shape is not None:
                    fill_shape(message, contact.shape, scale, size)
                used[topics.CONTACT].publish(message)
            if contact is not None and contact.shape and topics.CONTACT_POINT in used:
                place = set_header(PointStamped(), 1000 * estimate.end_us, frame_id)
                place.point = Point(x=contact.shape.x_mm * MM, y=contact.shape.y_mm * MM)
                used[topics.CONTACT_POINT].publish(place)
        carried = settings.displacement == 'windows'
        now_us = estimates[-1].end_us if carried else tracker.frame_us
        wanted = topics.DISPLACEMENT in used or topics.DISPLACEMENT_POINTS in used
        if tracker.touch is None or not wanted or now_us == self._field_us:
            return
        self._field_us, field = now_us, tracker.touch.field
        per_px = MM / scale.px_per_mm
        signs = np.array([per_px, -per_px], np.float32)[:, None, None]
        moved = np.asarray((tracker.moved() if carried else field.moved) * signs, np.float32)
        if topics.DISPLACEMENT in used:
            image = field_image(moved)
            used[topics.DISPLACEMENT].publish(set_header(image, 1000 * now_us, frame_id))
        if topics.DISPLACEMENT_POINTS in used:
            cloud = field_cloud(moved, field, scale, size)
            set_header(cloud, 1000 * now_us, frame_id)
            used[topics.DISPLACEMENT_POINTS].publish(cloud)


def fill_shape(
    message: Contact, shape: ContactShape, scale: SkinScale, size: tuple[int, int]
) -> None:
    """Write place and shape of a contact to a message.

    Args:
        message: Written to.
        shape: Place and shape.
        scale: Of the skin in the picture.
        size: Columns and rows of the camera's image [px].
    """
    message.position = Point(x=shape.x_mm * MM, y=shape.y_mm * MM)
    message.position_deviation = shape.deviation_mm * MM
    message.area = shape.area_mm2 * MM**2
    message.area_deviation = shape.area_deviation_mm2 * MM**2
    message.major, message.minor = shape.major_mm * MM, shape.minor_mm * MM
    message.angle = shape.angle
    column, row = scale.axis(*size)
    message.column = column + shape.x_mm * scale.px_per_mm
    message.row = row - shape.y_mm * scale.px_per_mm
    message.scale = scale.px_per_mm / MM


def field_image(moved: F32) -> Image:
    """Return a displacement [m] as an image of 32FC2; rows as in the camera's image."""
    height, width = moved.shape[1:]
    data = array.array('B', np.ascontiguousarray(moved.transpose(1, 2, 0)).tobytes())
    return Image(height=height, width=width, encoding='32FC2', step=8 * width, data=data)


def field_cloud(
    moved: F32, field: DisplacementField, scale: SkinScale, size: tuple[int, int]
) -> PointCloud2:
    """Return a displacement as a cloud with the fields `CLOUD_FIELDS`.

    Args:
        moved: Displacement [m], float32 [2, rows, columns].
        field: Its places and confidence.
        scale: Of the skin in the picture.
        size: Columns and rows of the camera's image [px].
    """
    height, width = moved.shape[1], moved.shape[2]
    places = MM * field_places((height, width), field.spacing_px, scale, size)
    points = np.concatenate([places, np.zeros_like(places[:1]), moved, field.confidence()[None]])
    fields = [
        PointField(name=name, offset=4 * index, datatype=PointField.FLOAT32, count=1)
        for index, name in enumerate(CLOUD_FIELDS)
    ]
    step = 4 * len(CLOUD_FIELDS)
    data = np.ascontiguousarray(points.transpose(1, 2, 0), np.float32)
    return PointCloud2(
        height=height,
        width=width,
        fields=fields,
        point_step=step,
        row_step=step * width,
        is_dense=True,
        data=array.array('B', data.tobytes()),
    )
