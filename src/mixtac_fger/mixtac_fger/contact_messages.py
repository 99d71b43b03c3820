# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Publishers of contact and displacement: messages in the contact frame, in metres."""

from __future__ import annotations

import array
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from geometry_msgs.msg import PointStamped
from numpy.typing import NDArray
from sensor_msgs.msg import Image, PointCloud2, PointField

from mixtac_core.node import topics
from mixtac_core.node.stamps import us_to_stamp
from mixtac_fger.displacement import field_places
from mixtac_msgs.msg import Contact

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mixtac_fger import contact_tracking
    from mixtac_fger.displacement import DisplacementField, SkinScale
    from mixtac_fger.estimator import Estimate
    from mixtac_fger.parameters import FgerParameters
    from mixtac_fger.streaming import ForceEstimator

F32 = NDArray[np.float32]
MM: Final = 1e-3
CLOUD_FIELDS: Final = ('x', 'y', 'z', 'dx', 'dy', 'confidence')


class ContactOutputs:
    """Publishers of contact and displacement, offered where they are wanted, and only there.

    Args:
        node: An rclpy lifecycle node of `mixtac_core.node.base_node`.
    """

    def __init__(self, node: Any) -> None:  # noqa: ANN401
        self._node = node
        self._contact: tuple[Any, ...] = ()
        self._field: tuple[Any, ...] = ()
        self._located = Contact()
        self._field_us = 0

    @property
    def offered(self) -> bool:
        """Whether contacts have to be found."""
        return bool(self._contact)

    def open(self, settings: FgerParameters) -> None:
        """Offer what is wanted."""
        field = settings.displacement != 'off'
        contact = settings.contact or field
        if (contact, field) == (bool(self._contact), bool(self._field)):
            return
        self.close()
        create = self._node.publish_topic
        if contact:
            outputs = (topics.CONTACT, topics.CONTACT_POINT)
            self._contact = tuple(create(each, managed=True) for each in outputs)
        if field:
            outputs = (topics.DISPLACEMENT, topics.DISPLACEMENT_POINTS)
            self._field = tuple(create(each, managed=True) for each in outputs)

    def close(self) -> None:
        """Offer nothing."""
        for publisher in (*self._contact, *self._field):
            self._node.destroy_publisher(publisher)
        self._contact = self._field = ()

    def publish(
        self, estimator: ForceEstimator, estimates: Sequence[Estimate], settings: FgerParameters
    ) -> None:
        """Publish what belongs to estimates; without a subscriber it is not even computed.

        Args:
            estimator: Gave the estimates.
            estimates: Of the latest windows, at least one.
            settings: Parameters of the node.
        """
        contact, field = (
            [each.get_subscription_count() > 0 for each in publishers]
            for publishers in (self._contact, self._field)
        )
        estimator.contact_wanted = any(contact) or any(field)
        tracker = estimator.contact
        if tracker is None:
            return
        frame_id, size = settings.frame_id, estimator.size
        if any(contact):
            for estimate in estimates:
                self._publish_contact(estimate, tracker.settings.scale, size, frame_id, contact)
        if any(field):
            carried = settings.displacement == 'windows'
            end_us = estimates[-1].end_us if carried else tracker.frame_us
            self._publish_field(tracker, end_us, size, frame_id, field, carried=carried)

    def _publish_contact(
        self,
        estimate: Estimate,
        scale: SkinScale,
        size: tuple[int, int],
        frame_id: str,
        wanted: list[bool],
    ) -> None:
        found = estimate.contact
        if found is None:
            return
        if wanted[0]:
            # A located contact fills every field: no need for a new message.
            message = self._located if found.shape is not None else Contact()
            stamp(message, estimate.end_us, frame_id)
            fill_contact(message, found, estimate.frame_age_us, scale, size)
            self._contact[0].publish(message)
        if wanted[1] and found.shape is not None:
            place = stamp(PointStamped(), estimate.end_us, frame_id)
            fill_point(place.point, found)
            self._contact[1].publish(place)

    def _publish_field(
        self,
        tracker: contact_tracking.ContactTracker,
        stamp_us: int,
        size: tuple[int, int],
        frame_id: str,
        wanted: list[bool],
        *,
        carried: bool,
    ) -> None:
        """Publish the displacement of a new frame, or carried on to the latest window."""
        touch, scale = tracker.touch, tracker.settings.scale
        if touch is None or stamp_us == self._field_us:
            return
        self._field_us = stamp_us
        moved = metric(tracker.moved() if carried else touch.field.moved, scale)
        if wanted[0]:
            image = stamp(Image(), stamp_us, frame_id)
            fill_field(image, moved)
            self._field[0].publish(image)
        if wanted[1]:
            cloud = stamp(PointCloud2(), stamp_us, frame_id)
            fill_cloud(cloud, moved, touch.field, scale, size)
            self._field[1].publish(cloud)


def stamp(message: Any, stamp_us: int, frame_id: str) -> Any:  # noqa: ANN401
    """Write the header of a message, and return the message.

    Args:
        message: Any message with a header.
        stamp_us: Camera clock [us].
        frame_id: Frame of what the message tells.
    """
    message.header.stamp = us_to_stamp(stamp_us)
    message.header.frame_id = frame_id
    return message


def fill_contact(
    message: Contact,
    contact: contact_tracking.Contact,
    frame_age_us: int,
    scale: SkinScale,
    size: tuple[int, int],
) -> None:
    """Write everything but the header of a contact.

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


def fill_point(point: Any, contact: contact_tracking.Contact) -> None:  # noqa: ANN401
    """Write the place of a located contact to a `geometry_msgs/Point`."""
    assert contact.shape is not None  # noqa: S101  (the caller has looked)
    point.x, point.y, point.z = contact.shape.x_mm * MM, contact.shape.y_mm * MM, 0.0


def metric(moved: F32, scale: SkinScale) -> F32:
    """Return a displacement in the image [2, rows, columns] [px] in the contact frame [m]."""
    per_px = MM / scale.px_per_mm
    signs = np.array([per_px, -per_px], np.float32)[:, None, None]
    return np.asarray(moved * signs, np.float32)


def fill_field(message: Image, moved: F32) -> None:
    """Write a displacement [m] to an image as 32FC2; rows as in the camera's image."""
    message.height, message.width = moved.shape[1:]
    message.encoding, message.is_bigendian = '32FC2', 0
    message.step = 8 * moved.shape[2]
    message.data = array.array('B', np.ascontiguousarray(moved.transpose(1, 2, 0)).tobytes())


def fill_cloud(
    message: PointCloud2,
    moved: F32,
    field: DisplacementField,
    scale: SkinScale,
    size: tuple[int, int],
) -> None:
    """Write a displacement to a cloud with the fields `CLOUD_FIELDS`.

    Args:
        message: Written to.
        moved: Displacement [m], float32 [2, rows, columns].
        field: Whose places and confidence.
        scale: Of the skin in the picture.
        size: Columns and rows of the camera's image [px].
    """
    shape = moved.shape[1], moved.shape[2]
    places = MM * field_places(shape, field.spacing_px, scale, size)
    flat = np.zeros_like(places[:1])
    points = np.concatenate([places, flat, moved, field.confidence()[None]])
    message.height, message.width = shape
    message.fields = [
        PointField(name=name, offset=4 * index, datatype=PointField.FLOAT32, count=1)
        for index, name in enumerate(CLOUD_FIELDS)
    ]
    message.point_step = 4 * len(CLOUD_FIELDS)
    message.row_step, message.is_dense = message.point_step * shape[1], True
    data = np.ascontiguousarray(points.transpose(1, 2, 0), np.float32)
    message.data = array.array('B', data.tobytes())
