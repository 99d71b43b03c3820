# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Serialised messages as the driver and the virtual sensor publish them, made without ROS."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mixtac_bringup.simulate.stamped_rows import StampedRows

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

    from mixtac_bringup.simulate.trial_clocks import ClockTruth
    from mixtac_driver.packetizer import Packet
    from mixtac_driver.readings import Frame

BIT_SHIFT: Final = 6
"""From 10-bit values to the upper bits of 16."""
SIZE: Final = (346, 260)
"""Width and height of both arrays."""
_NS: Final = 1_000_000_000
_NO_ORIENTATION: Final = np.array([-1.0, *[0.0] * 8])
_UNKNOWN: Final = np.zeros(9)


class MessageFactory:
    """Makes CDR messages with rosbags' type store.

    Args:
        store: Type store with the types of the workspace.
        frame_ids: Frames of camera, inertial unit, contact and reference sensor.
        serial: Serial number of the camera.
    """

    def __init__(self, store: Typestore, frame_ids: dict[str, str], serial: str) -> None:
        self._store = store
        self._frame_ids = frame_ids
        self._serial = serial
        self.reference_wrenches = self._wrench_rows('reference')
        self.true_wrenches = self._wrench_rows('contact')
        self.contact_points = self._point_rows()
        self.imu_samples = self._imu_rows()

    def event_packet(self, packet: Packet, sequence: int) -> bytes:
        """Return an `EventPacket`; its header's stamp is the host time of arrival."""
        width, height = SIZE
        return self._bytes(
            'event_camera_msgs/msg/EventPacket',
            header=self._header(packet.arrival_ns, 'camera'),
            height=height,
            width=width,
            seq=sequence,
            time_base=packet.encoded.time_base,
            encoding=packet.encoded.encoding,
            is_bigendian=False,
            events=np.frombuffer(packet.encoded.payload, np.uint8),
        )

    def image(self, frame: Frame, origin_us: int) -> bytes:
        """Return the `Image` of a frame: mono16, ten bits in the upper ones, at mid-exposure."""
        height, width = frame.image.shape
        return self._bytes(
            'sensor_msgs/msg/Image',
            header=self._frame_header(frame, origin_us),
            height=height,
            width=width,
            encoding='mono16',
            is_bigendian=int(sys.byteorder == 'big'),
            step=2 * width,
            data=np.left_shift(frame.image, BIT_SHIFT).view(np.uint8).ravel(),
        )

    def camera_info(self, frame: Frame, origin_us: int) -> bytes:
        """Return the `CameraInfo` of a frame: its size, no calibration."""
        width, height = SIZE
        return self._bytes(
            'sensor_msgs/msg/CameraInfo',
            header=self._frame_header(frame, origin_us),
            height=height,
            width=width,
            distortion_model='',
            d=np.zeros(0),
            k=np.zeros(9),
            r=np.zeros(9),
            p=np.zeros(12),
            binning_x=0,
            binning_y=0,
            roi=self._make(
                'sensor_msgs/msg/RegionOfInterest',
                x_offset=0,
                y_offset=0,
                height=0,
                width=0,
                do_rectify=False,
            ),
        )

    def frame_exposure(self, frame: Frame, origin_us: int) -> bytes:
        """Return the `FrameExposure` of a frame."""
        return self._bytes(
            'mixtac_msgs/msg/FrameExposure',
            header=self._frame_header(frame, origin_us),
            frame_start=self._time(1000 * (frame.frame_start_us + origin_us)),
            exposure_start=self._time(1000 * (frame.exposure_start_us + origin_us)),
            exposure_end=self._time(1000 * (frame.exposure_end_us + origin_us)),
            frame_end=self._time(1000 * (frame.frame_end_us + origin_us)),
            shutter=int(not frame.global_shutter),
        )

    def temperature(self, celsius: float, time_us: int) -> bytes:
        """Return a `Temperature` of the inertial unit at a time [us, epoch-based camera clock]."""
        return self._bytes(
            'sensor_msgs/msg/Temperature',
            header=self._header(1000 * time_us, 'imu'),
            temperature=celsius,
            variance=0.0,
        )

    def camera_clock(self, host_ns: int, camera_us: int) -> bytes:
        """Return the `TimeReference` of the camera clock [us] at a host time [ns]."""
        return self._bytes(
            'sensor_msgs/msg/TimeReference',
            header=self._make('std_msgs/msg/Header', stamp=self._time(host_ns), frame_id=''),
            time_ref=self._time(1000 * camera_us),
            source=self._serial,
        )

    def clock_fit(self, truth: ClockTruth, host_ns: int) -> bytes:
        """Return the `ClockFit` that holds in truth."""
        return self._bytes(
            'mixtac_msgs/msg/ClockFit',
            header=self._make('std_msgs/msg/Header', stamp=self._time(host_ns), frame_id=''),
            a=truth.rate,
            b=truth.offset_s,
            covariance=np.zeros(4),
            camera_epoch=truth.epoch_s,
            reference_epoch=truth.epoch_s,
            camera_anchors=np.zeros(0),
            reference_anchors=np.zeros(0),
            residuals=np.zeros(0),
            residual_rms=0.0,
            method='simulation',
            message='true relation of the clocks',
        )

    def _wrench_rows(self, frame: str) -> StampedRows:
        vector = self._make('geometry_msgs/msg/Vector3', x=0.0, y=0.0, z=0.0)
        wrench = self._make('geometry_msgs/msg/Wrench', force=vector, torque=vector)
        header = self._header(0, frame)
        return StampedRows(
            self._bytes('geometry_msgs/msg/WrenchStamped', header=header, wrench=wrench), 6
        )

    def _point_rows(self) -> StampedRows:
        point = self._make('geometry_msgs/msg/Point', x=0.0, y=0.0, z=0.0)
        header = self._header(0, 'contact')
        return StampedRows(
            self._bytes('geometry_msgs/msg/PointStamped', header=header, point=point), 3
        )

    def _imu_rows(self) -> StampedRows:
        vector = self._make('geometry_msgs/msg/Vector3', x=0.0, y=0.0, z=0.0)
        sample = self._bytes(
            'sensor_msgs/msg/Imu',
            header=self._header(0, 'imu'),
            orientation=self._make('geometry_msgs/msg/Quaternion', x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=_NO_ORIENTATION,
            angular_velocity=vector,
            angular_velocity_covariance=_UNKNOWN,
            linear_acceleration=vector,
            linear_acceleration_covariance=_UNKNOWN,
        )
        return StampedRows(sample, 37)

    def _frame_header(self, frame: Frame, origin_us: int) -> Any:  # noqa: ANN401
        return self._header(1000 * (frame.middle_us + origin_us), 'camera')

    def _header(self, stamp_ns: int, frame: str) -> Any:  # noqa: ANN401
        return self._make(
            'std_msgs/msg/Header', stamp=self._time(stamp_ns), frame_id=self._frame_ids[frame]
        )

    def _time(self, t_ns: int) -> Any:  # noqa: ANN401
        return self._make('builtin_interfaces/msg/Time', sec=t_ns // _NS, nanosec=t_ns % _NS)

    def _make(self, type_name: str, **fields: Any) -> Any:  # noqa: ANN401
        return self._store.types[type_name](**fields)

    def _bytes(self, type_name: str, **fields: Any) -> bytes:  # noqa: ANN401
        return bytes(self._store.serialize_cdr(self._make(type_name, **fields), type_name))
