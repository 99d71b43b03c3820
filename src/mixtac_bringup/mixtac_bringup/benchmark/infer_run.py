# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Running the estimator on a scene, paced as a camera would or as fast as it goes."""

from __future__ import annotations

import sys
import time
from array import array
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_bringup.benchmark.infer_scene import PACKET_US
from mixtac_fger.live_feed import LiveFeed
from mixtac_fger.streaming import ForceEstimator

if TYPE_CHECKING:
    from mixtac_bringup.benchmark.infer_scene import Frame, Scene
    from mixtac_fger.weights import LoadedModel

CONTACT_THRESHOLD_N: Final = 0.15
DEADLINE_S: Final = 0.002
"""A force that comes later than the end of the next window is late."""


@dataclass(frozen=True, slots=True)
class PacedRun:
    """A run in real time, frames in the background as in the node.

    Attributes:
        step_ms: Time of each call that closed a window, decoding of the packet included [ms].
        window_cpu_ms: Processor time of the thread of the windows per window, decoding of all its
            packets included [ms]; other processes hardly change it.
        forces: Forces that came out.
        late: Forces that came out more than 2 ms after their packet was handed over or due.
        frames_dropped: Frames replaced by a newer one before they were encoded.
        cpu: Processor time over real time, all threads.
    """

    step_ms: list[float]
    window_cpu_ms: float
    forces: int
    late: int
    frames_dropped: int
    cpu: float


def run_paced(model: LoadedModel, scene: Scene) -> PacedRun:
    """Hand over every packet and frame when the camera would.

    Args:
        model: Network with its weights, warmed up.
        scene: What to hand over.
    """
    feed = LiveFeed(model, CONTACT_THRESHOLD_N)
    steps: list[float] = []
    frames, late, count, thread_s = deque(scene.frames), 0, 0, 0.0
    cpu_s, start_s = time.process_time(), time.perf_counter()
    origin_us = scene.ends_us[0]
    for end_us, packet in zip(scene.ends_us, scene.packets, strict=True):
        while frames and frames[0].ready_us <= end_us:
            _hand_over(feed, frames.popleft())
        due_s = start_s + 1e-6 * (end_us - origin_us)
        time.sleep(max(due_s - time.perf_counter(), 0.0))
        called_s, before_s = time.perf_counter(), time.thread_time()
        forces = feed.packet(packet)
        done_s = time.perf_counter()
        thread_s += time.thread_time() - before_s
        if forces:
            count += len(forces)
            steps.append(1e3 * (done_s - called_s))
            late += done_s - due_s > DEADLINE_S
    cpu = (time.process_time() - cpu_s) / (time.perf_counter() - start_s)
    dropped = feed.status().estimator.frames_dropped
    feed.close()
    windows = max(len(scene.packets) * PACKET_US // model.config.window_us, 1)
    return PacedRun(steps, 1e3 * thread_s / windows, count, late, dropped, cpu)


def frame_times_ms(model: LoadedModel, scene: Scene) -> list[float]:
    """Return the time of each frame step of one thread, from image to correction-ready [ms]."""
    estimator = ForceEstimator(model)
    times = []
    for frame in scene.frames:
        start_s = time.perf_counter()
        estimator.push_frame(frame.image, frame.mid_us)
        times.append(1e3 * (time.perf_counter() - start_s))
    estimator.close()
    return times[model.config.reference_frames :]


def quantiles(values: list[float]) -> dict[str, float]:
    """Return the median and the 99th percentile."""
    p50, p99 = np.quantile(values, (0.5, 0.99))
    return {'p50': float(p50), 'p99': float(p99)}


@dataclass(slots=True)
class _ImageFields:
    """The fields of `sensor_msgs/Image` that the estimator reads."""

    height: int
    width: int
    encoding: str
    is_bigendian: int
    step: int
    data: array[int]


def _hand_over(feed: LiveFeed, frame: Frame) -> None:
    height, width = frame.image.shape
    data = array('B', frame.image.tobytes())
    big_endian = int(sys.byteorder == 'big')
    feed.image(_ImageFields(height, width, 'mono16', big_endian, 2 * width, data), frame.mid_us)
