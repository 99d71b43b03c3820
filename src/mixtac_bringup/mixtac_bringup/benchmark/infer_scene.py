# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the estimator is fed with when its speed is measured: a simulated trial as messages."""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_events.arrays import Events
from mixtac_events.codec import DAVIS346_HEIGHT, DAVIS346_WIDTH, encode
from mixtac_sim.datasets.trial_spec import TrialSpec
from mixtac_sim.datasets.trial_stream import TrialStream

if TYPE_CHECKING:
    from numpy.typing import NDArray

PACKET_US: Final = 1000
"""The driver's default."""
EPOCH_US: Final = 1_000_000
"""Camera time at the start of the trial; times in packets are not negative."""
DEVICE_SEED: Final = 910_000
TRIAL_SEED: Final = 911_000


@dataclass(slots=True)
class PacketFields:
    """The fields of `event_camera_msgs/EventPacket` that the estimator reads."""

    seq: int
    time_base: int
    encoding: str
    events: array[int]
    width: int = DAVIS346_WIDTH
    height: int = DAVIS346_HEIGHT
    is_bigendian: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A frame as it becomes available.

    Attributes:
        ready_us: Camera time at which its readout ends.
        mid_us: Centre of its exposure, camera clock [us].
        image: Intensity, uint16 [260, 346].
    """

    ready_us: int
    mid_us: int
    image: NDArray[np.uint16]


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A trial as the driver would publish it.

    Attributes:
        ends_us: Camera time up to which each packet is complete [us].
        packets: One per millisecond.
        frames: In the order in which they become available.
        events: Number of events.
    """

    ends_us: list[int]
    packets: list[PacketFields]
    frames: list[Frame]
    events: int


def make_scene(seconds: float, preset: str, profile: str = 'dynamic') -> Scene:
    """Simulate a trial and cut it into packets.

    Args:
        seconds: Length [s].
        preset: How hard the virtual sensor is.
        profile: Force profile.
    """
    spec = TrialSpec('infer', profile, seconds, DEVICE_SEED, TRIAL_SEED, preset, 'test')
    scene = Scene([], [], [], 0)
    count = 0
    for stretch in TrialStream(spec).stretches():
        events = stretch.sensor.events
        count += len(events)
        _cut(scene, events, stretch.start_us, stretch.end_us)
        scene.frames.extend(
            Frame(
                frame.frame_end_us + EPOCH_US,
                (frame.exposure_start_us + frame.exposure_end_us) // 2 + EPOCH_US,
                frame.intensity,
            )
            for frame in stretch.sensor.frames
        )
    return Scene(scene.ends_us, scene.packets, scene.frames, count)


def _cut(scene: Scene, events: Events, start_us: int, end_us: int) -> None:
    times = np.arange(start_us, end_us + 1, PACKET_US)
    cuts = np.searchsorted(events.t, times)
    for first, last, until in zip(cuts[:-1], cuts[1:], times[1:], strict=True):
        part = events[int(first) : int(last)]
        moved = Events(part.t + EPOCH_US, part.x, part.y, part.polarity)
        complete_us = int(until) + EPOCH_US
        packet = encode(moved, complete_until=complete_us)
        scene.ends_us.append(complete_us)
        scene.packets.append(
            PacketFields(
                seq=len(scene.packets),
                time_base=packet.time_base,
                encoding=packet.encoding,
                events=array('B', packet.payload.tobytes()),
            )
        )
