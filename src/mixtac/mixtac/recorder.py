# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Recording an open sensor: the topics of the live graph, without ROS; imported when asked for."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_fger.estimator import fill_quality
from mixtac_node import topics
from mixtac_recordings import messages
from mixtac_recordings.bag import blank_message
from mixtac_recordings.bag_writer import BagWriter
from mixtac_recordings.recording import RecordingError
from mixtac_recordings.stream_writer import StreamWriter

if TYPE_CHECKING:
    from mixtac_driver.camera import CameraBatch
    from mixtac_driver.davis346.model import Identity
    from mixtac_driver.source import Source
    from mixtac_events.arrays import Events
    from mixtac_fger.estimator import Estimate

TOPICS: Final = (
    topics.EVENTS,
    topics.IMAGE_RAW,
    topics.CAMERA_INFO,
    topics.IMAGE_EXPOSURE,
    topics.IMU,
    topics.EXTERNAL_EDGES,
    topics.CAMERA_CLOCK,
    topics.FORCE,
    topics.FORCE_QUALITY,
)
CLOCK_PERIOD_S: Final = 1.0


class Recorder:
    """Writes batches and estimates to a bag; never blocks, drops what the disk cannot take.

    Args:
        path: Folder of the new bag.
        identity: The camera.
        source: What the batches come from.

    Raises:
        RecordingError: The folder exists already or cannot be made.
    """

    def __init__(self, path: Path, identity: Identity, source: Source) -> None:
        self._serial, self._source = identity.serial, source
        self._bag = BagWriter(path)
        size, color_filter = identity.geometry.event_size, identity.features.color_filter
        self._writer = StreamWriter(self._bag, size, color_filter=color_filter)
        self._writer.announce(*TOPICS)
        self._clock_due_s = 0.0

    @property
    def dropped(self) -> int:
        """Messages that the disk did not take in time."""
        return self._bag.dropped

    def write(
        self,
        batch: CameraBatch,
        events: Events,
        estimates: Sequence[Estimate],
        forces: Sequence[float],
    ) -> None:
        """Write a batch and what was estimated with it.

        Args:
            batch: The batch.
            events: Its events on the epoch-based camera clock.
            estimates: Estimates of the windows that it completed.
            forces: What is given out of them [N]; NaN for those withheld.
        """
        decoded, origin_us, arrival_ns = batch.decoded, batch.origin.us, batch.arrival_ns
        writer = self._writer
        writer.events(events, batch.time_us, arrival_ns)
        for frame in decoded.frames:
            writer.frame(frame, origin_us, arrival_ns)
        writer.samples(decoded.imu, origin_us, arrival_ns)
        writer.edges(decoded.edges, origin_us, arrival_ns)
        for estimate, force in zip(estimates, forces, strict=True):
            self._write_estimate(estimate, force, arrival_ns)
        if time.monotonic() >= self._clock_due_s:
            self._write_clock(batch)

    def close(self) -> None:
        """Finish the bag.

        Raises:
            RecordingError: It could not be finished, or messages are missing.
        """
        self._bag.close()
        if self._bag.failure or self.dropped:
            raise RecordingError(
                f'the bag lacks messages, {self.dropped} at least: '
                f'{self._bag.failure or "the disk is too slow"}',
                remedy='record to a faster disk with free space',
            )

    def _write_estimate(self, estimate: Estimate, force: float, arrival_ns: int) -> None:
        stamp_ns, frame_id = 1000 * estimate.end_us, topics.CONTACT_FRAME
        if math.isfinite(force):
            values = np.array([0.0, 0.0, force, 0.0, 0.0, 0.0])
            self._writer.wrench(topics.FORCE, stamp_ns, values, frame_id, arrival_ns)
        message = blank_message(topics.FORCE_QUALITY.type_name)
        messages.set_header(message, stamp_ns, frame_id)
        fill_quality(message, estimate)
        self._writer.put(topics.FORCE_QUALITY, arrival_ns, message)

    def _write_clock(self, batch: CameraBatch) -> None:
        clock = self._source.status().clock
        if not clock.ready:
            return
        self._clock_due_s = time.monotonic() + CLOCK_PERIOD_S
        host_ns = batch.arrival_ns
        camera_us = clock.to_camera_us(host_ns) + batch.origin.us
        message = messages.camera_clock(host_ns, camera_us, self._serial, blank_message)
        self._writer.put(topics.CAMERA_CLOCK, host_ns, message)
