# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Lets a camera run for some seconds and counts what comes."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from mixtac_driver.driver_status import LOSSES

if TYPE_CHECKING:
    from mixtac_driver.camera import Davis346
    from mixtac_driver.clock_map import ClockEstimate
    from mixtac_driver.transfer_queue import TransportCounters


@dataclass(frozen=True, slots=True)
class Measurement:
    """What came from a camera.

    Attributes:
        seconds: How long it ran after its first data, by the camera's clock [s].
        elapsed_s: The same by the host's clock, when the last data were decoded [s].
        events: Events.
        frames: Frames.
        samples: Inertial samples.
        edges: Edges of the external input and the generator.
        size: Bytes over USB.
        gaps_ms: Median and 99th percentile of the time between transfers [ms], NaN without two.
        losses: Decoder counters that stay at zero on a sound stream, by name, if not zero.
        transport: What the USB reader did.
        clock: The map from the camera's clock to the host's, or None without data.
        clock_resets: Resets of the camera's clock that nobody asked for.
        is_master: True where the camera runs on its own clock.
    """

    seconds: float
    elapsed_s: float
    events: int
    frames: int
    samples: int
    edges: int
    size: int
    gaps_ms: tuple[float, float]
    losses: dict[str, int]
    transport: TransportCounters
    clock: ClockEstimate | None
    clock_resets: int
    is_master: bool

    def rate(self, count: int) -> float:
        """Return a count per second of the camera's clock."""
        return count / self.seconds if self.seconds else 0.0


@dataclass
class _Counts:
    """Sums over batches."""

    events: int = 0
    frames: int = 0
    samples: int = 0
    edges: int = 0
    arrivals_ns: list[int] = field(default_factory=list)


def measure(camera: Davis346, seconds: float) -> Measurement:
    """Start an open camera, let it run, and stop it.

    Args:
        camera: An open camera.
        seconds: How long to count, from the first data on [s].

    Raises:
        UsbError: A request failed or the camera went away.
        StreamError: No data came, or the stream died.
    """
    camera.start()
    counts, began_s, began_us, size_before = _Counts(), 0.0, 0, 0
    elapsed_s = seconds_s = 0.0
    for batch in camera.batches():
        if not began_s:
            # The first call of the decoder may have compiled it: data waited meanwhile.
            began_s, began_us = time.monotonic(), batch.time_us
            size_before = camera.transport_counters.size
            continue
        counts.events += len(batch.decoded.events)
        counts.frames += len(batch.decoded.frames)
        counts.samples += len(batch.decoded.imu.t)
        counts.edges += len(batch.decoded.edges.t)
        if not counts.arrivals_ns or counts.arrivals_ns[-1] != batch.arrival_ns:
            counts.arrivals_ns.append(batch.arrival_ns)
        elapsed_s, seconds_s = time.monotonic() - began_s, (batch.time_us - began_us) / 1e6
        if elapsed_s >= seconds:
            break
    transport, decoder = camera.transport_counters, camera.decoder_counters
    result = Measurement(
        seconds=seconds_s,
        elapsed_s=elapsed_s,
        events=counts.events,
        frames=counts.frames,
        samples=counts.samples,
        edges=counts.edges,
        size=transport.size - size_before,
        gaps_ms=_gaps_ms(counts.arrivals_ns),
        losses=_losses(decoder.as_dict() if decoder else {}),
        transport=transport,
        clock=camera.clock.estimate() if camera.clock.ready else None,
        clock_resets=camera.clock_resets,
        is_master=camera.is_master,
    )
    camera.stop()
    return result


def _gaps_ms(arrivals_ns: list[int]) -> tuple[float, float]:
    if len(arrivals_ns) < 2:
        return (float('nan'), float('nan'))
    middle, late = np.quantile(np.diff(arrivals_ns) / 1e6, (0.5, 0.99))
    return (float(middle), float(late))


def _losses(counted: dict[str, int]) -> dict[str, int]:
    return {name: counted[name] for name in LOSSES if counted.get(name)}
