# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What streaming takes and gives: settings, and the stretches that a camera yields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mixtac_driver.decoder import DEFAULT_CAPACITY

if TYPE_CHECKING:
    from mixtac_driver.decoder import DecodedBatch
    from mixtac_driver.sequences import Origin


@dataclass(frozen=True, slots=True)
class StreamSettings:
    """How data are taken from the camera.

    Attributes:
        transfers: Reads that wait at the endpoint at once, where the backend can do that.
        transfer_size: Bytes asked for per read.
        queue_size: Bytes that may wait to be decoded, besides those in the transfers.
        event_capacity: Events per batch.
        silence_s: Time without any data [s] after which the stream counts as dead; a running
            camera sends time wraps every 33 ms.
        confirmation_s: Time [s] within which the camera has to confirm the reset of its clock.
    """

    transfers: int = 128
    transfer_size: int = 65536
    queue_size: int = 32 << 20
    event_capacity: int = DEFAULT_CAPACITY
    silence_s: float = 3.0
    confirmation_s: float = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class CameraBatch:
    """A stretch of what the camera saw.

    Attributes:
        decoded: Events, frames, inertial samples and edges [us on the camera clock since its
            reset]. The events are views that the next batch overwrites.
        origin: Add `origin.us` to those times to get them on the epoch-based camera clock, which
            never goes back, not even when the camera's own clock is reset.
        arrival_ns: Host time of the transfer's arrival [ns since the Unix epoch].
    """

    decoded: DecodedBatch
    origin: Origin
    arrival_ns: int

    @property
    def time_us(self) -> int:
        """Time that the stream has reached [us, epoch-based camera clock]."""
        return self.decoded.time_us + self.origin.us
