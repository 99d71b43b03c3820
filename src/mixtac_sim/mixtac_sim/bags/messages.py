# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Serialised messages of a simulated trial, made without ROS, and the clocks of their stamps.

True time counts from the start of the trial. The host's clock runs with true time; the camera's
begins with the trial, as the driver resets it, and runs a little fast or slow; the reference
sensor's has an offset and a drift of its own. Messages are put in the order in which a recorder
would have received them.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from mixtac_sim.random_streams import stream
from mixtac_sim.usb.stream import Oscillator

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray
    from rosbags.typesys.store import Typestore

    from mixtac_events.packetizer import Packet
    from mixtac_events.readings import Frame
    from mixtac_sim.world.instruments import ReferenceSensor


FIRST_DAY_NS: Final = 1_767_225_600_000_000_000
"""2026-01-01 00:00 UTC: simulated trials lie from here on, an hour apart by their seeds."""
HOUR_NS: Final = 3_600_000_000_000
HOURS: Final = 100_000
LARGEST_SKEW_PPM: Final = 50.0
"""Usual tolerance of a crystal oscillator."""
USB_DELAY_US: Final = (150.0, 100.0)
"""Least time from the end of a USB transfer to the host's stamp, and mean of what comes on top
(estimates)."""


@dataclass(frozen=True, slots=True)
class ClockTruth:
    """True relation of the clocks.

    Attributes:
        rate: Reference clock over camera clock.
        offset_s: Reference clock less its epoch when the camera clock is at its own [s].
        epoch_s: Epoch of both [s since the Unix epoch].
    """

    rate: float
    offset_s: float
    epoch_s: float


class TrialClocks:
    """Converts the times of one trial.

    Args:
        trial_seed: Fixes the camera's skew, the delays and the day.

    Attributes:
        skew_ppm: How much faster than the host's the camera's clock runs [1e-6].
        epoch_ns: Host time at true time 0 [ns since the Unix epoch].
        origin_us: Host time at which the camera's clock read zero [us since the Unix epoch].
    """

    def __init__(self, trial_seed: int) -> None:
        self.skew_ppm = float(
            stream(trial_seed, 'camera clock').uniform(-LARGEST_SKEW_PPM, LARGEST_SKEW_PPM)
        )
        self.epoch_ns = FIRST_DAY_NS + HOUR_NS * (trial_seed % HOURS)
        self.origin_us = self.epoch_ns // 1000
        self._oscillator = Oscillator(self.skew_ppm)
        self._delays = stream(trial_seed, 'usb delay')

    def to_camera_us(self, true_us: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert true time [us] to the camera's clock since its reset [us]."""
        return self._oscillator.to_camera(true_us)

    def camera_us(self, true_us: int) -> int:
        """Convert one true time [us] to the camera's clock since its reset [us]."""
        return self._oscillator.now(true_us)

    def to_host_ns(self, true_us: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert true time [us] to the host's [ns since the Unix epoch]."""
        return np.asarray(self.epoch_ns + 1000 * true_us, np.int64)

    def arrivals_ns(self, end_us: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return when the host has transfers that end at true times [us]; draws new delays.

        The delays are at least `USB_DELAY_US[0]`; arrivals are in order.
        """
        least, mean = USB_DELAY_US
        delays_us = least + self._delays.exponential(mean, len(end_us))
        arrivals = self.to_host_ns(end_us) + np.round(1000 * delays_us).astype(np.int64)
        return np.asarray(np.maximum.accumulate(arrivals), np.int64)

    def reference_stamps_ns(self, t_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert times on the reference sensor's clock [ns] to its published stamps [ns]."""
        return np.asarray(self.epoch_ns + t_ns, np.int64)

    def truth(self, reference: ReferenceSensor) -> ClockTruth:
        """Return how the reference sensor's published stamps follow from the camera's."""
        rate = (1.0 + 1e-6 * reference.drift_ppm) / (1.0 + 1e-6 * self.skew_ppm)
        return ClockTruth(rate, reference.offset_s, 1e-9 * self.epoch_ns)


NS = 1_000_000_000
_STAMP_AT = 4
"""After CDR's four bytes that name the byte order."""


class StampedRows:
    """Serialises messages that begin with a header and end with doubles.

    Args:
        example: One such message in little-endian CDR; all else is taken from it.
        numbers: How many doubles it ends with.
    """

    def __init__(self, example: bytes, numbers: int) -> None:
        self._example = example
        self._layout = np.dtype(
            {
                'names': ['sec', 'nanosec', 'numbers'],
                'formats': ['<i4', '<u4', ('<f8', numbers)],
                'offsets': [_STAMP_AT, _STAMP_AT + 4, len(example) - 8 * numbers],
                'itemsize': len(example),
            }
        )

    @property
    def numbers(self) -> NDArray[np.float64]:
        """Return the doubles of the example."""
        row = np.frombuffer(self._example, self._layout)[0]
        return np.array(row['numbers'], np.float64)

    def make(self, stamp_ns: NDArray[np.int64], numbers: NDArray[np.float64]) -> list[bytes]:
        """Return one message per row.

        Args:
            stamp_ns: Stamps [n] [ns].
            numbers: The doubles [n, numbers].
        """
        octets = bytearray(self._example * len(stamp_ns))
        rows = np.frombuffer(octets, self._layout)
        rows['sec'], rows['nanosec'] = stamp_ns // NS, stamp_ns % NS
        rows['numbers'] = numbers
        size = len(self._example)
        return [bytes(octets[i : i + size]) for i in range(0, len(octets), size)]


class BagMessage(NamedTuple):
    """One message of a bag.

    Attributes:
        received_ns: When a recorder would have had it [ns since the Unix epoch].
        topic: Name relative to the namespace, or absolute.
        data: Serialised message.
    """

    received_ns: int
    topic: str
    data: bytes


class MessageSink:
    """Sorts messages by the time of their reception; those of one time keep their order."""

    def __init__(self) -> None:
        self._waiting: list[BagMessage] = []

    def put(self, received_ns: int, topic: str, data: bytes) -> None:
        """Add a message."""
        self._waiting.append(BagMessage(received_ns, topic, data))

    def put_rows(self, received_ns: Iterable[int], topic: str, rows: Iterable[bytes]) -> None:
        """Add messages of one topic.

        Args:
            received_ns: When each was received.
            topic: Their topic.
            rows: The messages.
        """
        pairs = zip(received_ns, rows, strict=True)
        self._waiting.extend(BagMessage(when, topic, row) for when, row in pairs)

    def take(self, until_ns: int) -> list[BagMessage]:
        """Return and forget the messages received before a time [ns], in order."""
        due = [message for message in self._waiting if message.received_ns < until_ns]
        self._waiting = [message for message in self._waiting if message.received_ns >= until_ns]
        due.sort(key=lambda message: message.received_ns)
        return due


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
