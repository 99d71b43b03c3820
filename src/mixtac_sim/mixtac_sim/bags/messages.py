# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Serialised messages of a simulated trial, made without ROS, and the clocks of their stamps.

True time counts from the start of the trial. The host's clock runs with true time; the camera's
begins with the trial, as the driver resets it, and runs a little fast or slow; the reference
sensor's has an offset and a drift of its own. Messages are put in the order in which a recorder
would have received them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from mixtac_events.readings import InertialSamples
from mixtac_node import topics
from mixtac_recordings import messages
from mixtac_recordings.bag import blank_message
from mixtac_sim.random_streams import stream
from mixtac_sim.usb.stream import Oscillator

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray
    from rosbags.typesys.store import Typestore

    from mixtac_events.packetizer import Packet
    from mixtac_events.readings import Frame
    from mixtac_node.topics import Topic
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


SIZE: Final = (346, 260)
"""Width and height of both arrays."""


class MessageFactory:
    """Makes the CDR messages of a trial.

    Args:
        store: Type store with the types of the workspace.
        frame_ids: Frames of camera, inertial unit, contact and reference sensor.
        serial: Serial number of the camera.
    """

    def __init__(self, store: Typestore, frame_ids: dict[str, str], serial: str) -> None:
        self._store = store
        self._frame_ids = frame_ids
        self._serial = serial
        self.reference_wrenches = self._rows(topics.REFERENCE_WRENCH, 'reference', 6)
        self.true_wrenches = self._rows(topics.TRUTH_WRENCH, 'contact', 6)
        self.contact_points = self._rows(topics.TRUTH_CONTACT, 'contact', 3)
        zero = np.zeros((1, 3))
        still = InertialSamples(np.zeros(1, np.int64), zero, zero, np.zeros(1))
        sample = messages.imu(still, 0, 0, frame_ids['imu'], blank_message)
        self.imu_samples = StampedRows(self._bytes(sample), 37)

    def event_packet(self, packet: Packet, sequence: int) -> bytes:
        """Return an `EventPacket`; its stamp is the host time of arrival."""
        camera = self._frame_ids['camera']
        return self._bytes(messages.event_packet(packet, sequence, SIZE, camera, blank_message))

    def image(self, frame: Frame, origin_us: int) -> bytes:
        """Return the `Image` of a frame."""
        return self._bytes(
            messages.image(frame, origin_us, 0, self._frame_ids['camera'], blank_message)
        )

    def camera_info(self, frame: Frame, origin_us: int) -> bytes:
        """Return the `CameraInfo` of a frame: its size, no calibration."""
        image = self._image_header(frame, origin_us)
        return self._bytes(messages.camera_info(frame, SIZE, image, blank_message))

    def frame_exposure(self, frame: Frame, origin_us: int) -> bytes:
        """Return the `FrameExposure` of a frame."""
        image = self._image_header(frame, origin_us)
        return self._bytes(messages.frame_exposure(frame, origin_us, image, blank_message))

    def temperature(self, celsius: float, time_us: int) -> bytes:
        """Return a `Temperature` of the inertial unit at a time [us, epoch-based camera clock]."""
        unit = self._frame_ids['imu']
        return self._bytes(messages.temperature(celsius, time_us, unit, blank_message))

    def camera_clock(self, host_ns: int, camera_us: int) -> bytes:
        """Return the `TimeReference` of the camera clock [us] at a host time [ns]."""
        return self._bytes(messages.camera_clock(host_ns, camera_us, self._serial, blank_message))

    def clock_fit(self, truth: ClockTruth, host_ns: int) -> bytes:
        """Return the `ClockFit` that holds in truth."""
        message = blank_message(topics.CLOCK_FIT.type_name)
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(host_ns, NS)
        message.a, message.b = truth.rate, truth.offset_s
        message.camera_epoch = message.reference_epoch = truth.epoch_s
        message.method, message.message = 'simulation', 'true relation of the clocks'
        return self._bytes(message)

    def _rows(self, topic: Topic, frame: str, numbers: int) -> StampedRows:
        message = blank_message(topic.type_name)
        message.header.frame_id = self._frame_ids[frame]
        return StampedRows(self._bytes(message), numbers)

    def _image_header(self, frame: Frame, origin_us: int) -> Any:  # noqa: ANN401
        return messages.image_header(frame, origin_us, self._frame_ids['camera'], blank_message)

    def _bytes(self, message: Any) -> bytes:  # noqa: ANN401
        return bytes(self._store.serialize_cdr(message, message.__msgtype__))
