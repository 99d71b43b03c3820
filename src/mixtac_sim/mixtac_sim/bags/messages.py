# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Clocks, serialisation and order of the messages of a simulated trial, without ROS.

True time counts from the start of the trial. The host's clock runs with true time; the camera's
begins with the trial, as the driver resets it, and runs a little fast or slow; the reference
sensor's has an offset and a drift of its own. Messages are put in the order in which a recorder
would have received them.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixtac_recordings.bag import typestore
from mixtac_sim.random_streams import stream
from mixtac_sim.usb.stream import Oscillator
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


class TrialClocks:
    """Converts the times of one trial.

    Args:
        trial_seed: Fixes the camera's skew, the delays and the day.

    Attributes:
        skew_ppm: Rate of the camera's clock over the host's, less one [1e-6].
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

    def reference_rate(self, reference: ReferenceSensor) -> float:
        """Return the true rate of the reference sensor's clock over the camera's."""
        return (1.0 + 1e-6 * reference.drift_ppm) / (1.0 + 1e-6 * self.skew_ppm)


NS = 1_000_000_000
_STAMP_AT = 4
"""After CDR's four bytes that name the byte order."""


def serialised(message: Any) -> bytes:  # noqa: ANN401
    """Return a message of `mixtac_recordings.bag.blank_message` in CDR."""
    return bytes(typestore().serialize_cdr(message, message.__msgtype__))


class StampedRows:
    """Serialises messages that begin with a header and end with doubles.

    Args:
        example: One such message of `blank_message`; all other fields are taken from it.
        numbers: Number of doubles at its end.
    """

    def __init__(self, example: Any, numbers: int) -> None:  # noqa: ANN401
        self._example = example = serialised(example)
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
        received_ns: Reception by a recorder [ns since the Unix epoch].
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

    def put(self, received_ns: int, topic: str, message: Any) -> None:  # noqa: ANN401
        """Add a message of `blank_message`."""
        self._waiting.append(BagMessage(received_ns, topic, serialised(message)))

    def put_rows(self, received_ns: Iterable[int], topic: str, rows: Iterable[bytes]) -> None:
        """Add messages of one topic.

        Args:
            received_ns: Time of reception of each [ns].
            topic: Their topic.
            rows: The messages, serialised.
        """
        pairs = zip(received_ns, rows, strict=True)
        self._waiting.extend(BagMessage(when, topic, row) for when, row in pairs)

    def take(self, until_ns: int) -> list[BagMessage]:
        """Return and forget the messages received before a time [ns], in order."""
        due = [message for message in self._waiting if message.received_ns < until_ns]
        self._waiting = [message for message in self._waiting if message.received_ns >= until_ns]
        due.sort(key=lambda message: message.received_ns)
        return due
