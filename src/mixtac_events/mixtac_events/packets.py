# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Packets of events, encoded and decoded, without ROS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mixtac_events.arrays import Events


@dataclass(frozen=True, slots=True, eq=False)
class EncodedPacket:
    """What the fields of an `event_camera_msgs/EventPacket` of the same names hold.

    Attributes:
        encoding: Name of the encoding, one of `mixtac_events.codec.ENCODINGS`.
        time_base: Camera clock [ns]; what it marks depends on the encoding. In an empty packet it
            is the time up to which the stream is known to be complete.
        payload: Encoded bytes, ``uint8``, little-endian.
    """

    encoding: str
    time_base: int
    payload: NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class DecodedPacket:
    """The content of one packet.

    Attributes:
        events: Events on the camera clock, in the order of the packet.
        complete_until: Camera clock [us]: the stream holds no further event before this time, so
            that windows ending here can be closed at once.
    """

    events: Events
    complete_until: int

    @property
    def start_us(self) -> int:
        """First time the packet speaks of, camera clock [us]."""
        return int(self.events.t[0]) if len(self.events) else self.complete_until
