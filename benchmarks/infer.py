# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Cost of an estimate, in time and in operations, on a simulated trial in real time."""

from __future__ import annotations

import sys
import time
from array import array
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Annotated, Any, Final

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console

from mixtac.figures import make_table
from mixtac.options import JsonFile, Preset
from mixtac_core.events.codec import decode_message, encode
from mixtac_core.events.codec import warm_up as warm_up_codec
from mixtac_core.events.windows import WindowSlicer
from mixtac_core.node.files import write_json
from mixtac_core.recordings.dataset import TrialSpec
from mixtac_fger.config import count_parameters, operations_per_cycle
from mixtac_fger.contact_tracking import ContactSettings
from mixtac_fger.estimator import open_estimator
from mixtac_fger.fger_net import FgerEstimator
from mixtac_fger.live_feed import LiveFeed
from mixtac_fger.streaming import ForceEstimator, warm_up
from mixtac_fger.validity import Validity
from mixtac_fger.weights import DEFAULT_MODEL, Model, find_model, read_model
from mixtac_sim.world.trial import TrialStream


def quantiles(values: Iterable[float]) -> dict[str, float]:
    """Return the median and the 99th percentile as `p50` and `p99`."""
    p50, p99 = np.quantile(list(values), (0.5, 0.99)).tolist()
    return {'p50': p50, 'p99': p99}


PACKET_US: Final = 1000
"""The driver's default."""
EPOCH_US: Final = 1_000_000
"""Camera time at the start of the trial; times in packets are not negative."""
DEVICE_SEED: Final = 910_000
TRIAL_SEED: Final = 911_000


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A frame and the time at which it is available.

    Attributes:
        ready_us: Camera time at the end of its readout [us].
        mid_us: Centre of its exposure, camera clock [us].
        image: Intensity, uint16 [260, 346].
    """

    ready_us: int
    mid_us: int
    image: NDArray[np.uint16]


@dataclass(slots=True, eq=False)
class Scene:
    """A trial as the driver publishes it.

    Attributes:
        ends_us: Camera time up to which each packet is complete [us].
        packets: Fields of one `event_camera_msgs/EventPacket` per millisecond.
        frames: Frames in the order in which they become available.
        events: Number of events.
    """

    ends_us: list[int]
    packets: list[Any]
    frames: list[Frame]
    events: int


def make_scene(seconds: float, preset: str) -> Scene:
    """Simulate a dynamic trial and cut it into packets.

    Args:
        seconds: Length [s].
        preset: Difficulty preset of the virtual sensor.
    """
    spec = TrialSpec('infer', 'dynamic', seconds, DEVICE_SEED, TRIAL_SEED, preset, 'test')
    scene = Scene([], [], [], 0)
    for stretch in TrialStream(spec).stretches():
        scene.events += len(stretch.sensor.events)
        for start_us in range(stretch.start_us, stretch.end_us, PACKET_US):
            part = stretch.sensor.events.between(start_us, start_us + PACKET_US)
            scene.ends_us.append(start_us + PACKET_US + EPOCH_US)
            packet = encode(part.shifted(EPOCH_US), complete_until=scene.ends_us[-1])
            scene.packets.append(
                SimpleNamespace(
                    seq=len(scene.packets),
                    time_base=packet.time_base,
                    encoding=packet.encoding,
                    events=array('B', packet.payload.tobytes()),
                    width=346,
                    height=260,
                    is_bigendian=False,
                )
            )
        for frame in stretch.sensor.frames:
            middle_us = (frame.exposure_start_us + frame.exposure_end_us) // 2
            times_us = (frame.frame_end_us + EPOCH_US, middle_us + EPOCH_US)
            scene.frames.append(Frame(*times_us, frame.intensity))
    return scene


DEADLINE_S: Final = 0.002
"""A force after the end of the next window is late [s]."""


def run_paced(model: Model, scene: Scene, contact: ContactSettings | None = None) -> dict[str, Any]:
    """Feed every packet and frame at its time, with frames in the background as in the node.

    Args:
        model: Content of a weight file whose estimator is warmed up.
        scene: Packets and frames.
        contact: How contacts are found; None for none.

    Returns:
        `step_ms`, the time of each call that gives a force, including the decoding of the packet
        [ms]; `between_ms`, that of the others, in which frames are used [ms]; `window_cpu_ms`, the
        processor time per window of the thread that computes windows, including the decoding of
        all packets [ms], which other processes hardly change; `windows`, the number of forces;
        `late`, that of forces more than 2 ms after their packet was due; `frames_dropped`, that of
        frames replaced by a newer one before they were encoded; `cpu`, processor time over real
        time, all threads.
    """
    feed = LiveFeed(ForceEstimator(open_estimator(model), background_frames=True, contact=contact))
    steps: list[float] = []
    others: list[float] = []
    frames, late, count, thread_s = deque(scene.frames), 0, 0, 0.0
    cpu_s, start_s = time.process_time(), time.perf_counter()
    origin_us = scene.ends_us[0]
    for end_us, packet in zip(scene.ends_us, scene.packets, strict=True):
        while frames and frames[0].ready_us <= end_us:
            _feed_image(feed, frames.popleft())
        due_s = start_s + 1e-6 * (end_us - origin_us)
        time.sleep(max(due_s - time.perf_counter(), 0.0))
        called_s, before_s = time.perf_counter(), time.thread_time()
        forces = feed.packet(packet)
        done_s = time.perf_counter()
        thread_s += time.thread_time() - before_s
        (steps if forces else others).append(1e3 * (done_s - called_s))
        if forces:
            count += len(forces)
            late += done_s - due_s > DEADLINE_S
    cpu = (time.process_time() - cpu_s) / (time.perf_counter() - start_s)
    dropped = feed.status().estimator.frames_dropped
    feed.close()
    windows = max(len(scene.packets) * PACKET_US // feed.estimator.window_us, 1)
    return {
        'step_ms': steps,
        'between_ms': others,
        'window_cpu_ms': 1e3 * thread_s / windows,
        'windows': count,
        'late': late,
        'frames_dropped': dropped,
        'cpu': cpu,
    }


def frame_times_ms(
    model: Model, scene: Scene, contact: ContactSettings | None = None
) -> list[float]:
    """Return the time of each frame step on one thread, from image to correction [ms]."""
    estimator = ForceEstimator(open_estimator(model), contact=contact)
    times = []
    for frame in scene.frames:
        start_s = time.perf_counter()
        estimator.push_frame(frame.image, frame.mid_us)
        times.append(1e3 * (time.perf_counter() - start_s))
    estimator.close()
    reference = estimator.reference
    return times[0 if reference is None else reference.frames :]


def validity_share(model: Model, scene: Scene) -> float:
    """Return the share of the checks of validity in the time of all windows, packets decoded.

    Packets follow one another at once, and the encoding of frames is left out. The checks run a
    second time on what the estimator was given; all of it is processor time of one thread.
    """
    estimator = ForceEstimator(open_estimator(model), assume_free=True)
    slicer = WindowSlicer(estimator.window_us)
    validity = Validity(estimator.size[0])
    frames, seen = deque(scene.frames), None
    whole_s = checks_s = 0.0
    for end_us, packet in zip(scene.ends_us, scene.packets, strict=True):
        while frames and frames[0].ready_us <= end_us:
            frame = frames.popleft()
            estimator.push_frame(frame.image, frame.mid_us)
        start_s = time.thread_time()
        decoded = decode_message(packet)
        estimator.push_events(decoded.events, decoded.complete_until)
        whole_s += time.thread_time() - start_s
        closed = slicer.push(decoded.events, decoded.complete_until)
        used = estimator.frame
        start_s = time.thread_time()
        if used is not None and used is not seen:
            validity.frame(used.mid_us, used.contrast, used.picture)
        for window_us, part in closed:
            validity.window(window_us, part, complete=True)
        checks_s += time.thread_time() - start_s
        seen = used
    estimator.close()
    return checks_s / whole_s


def _feed_image(feed: LiveFeed, frame: Frame) -> None:
    height, width = frame.image.shape
    message: Any = SimpleNamespace(
        height=height,
        width=width,
        encoding='mono16',
        is_bigendian=int(sys.byteorder == 'big'),
        step=2 * width,
        data=array('B', frame.image.tobytes()),
    )
    feed.image(message, frame.mid_us)


def infer(
    model: Annotated[str, typer.Option(help='Weight file, or name of a model.')] = DEFAULT_MODEL,
    seconds: Annotated[float, typer.Option(min=3, max=600, help='Length of the run (s).')] = 20.0,
    preset: Preset = 'paper_like',
    json: JsonFile = None,
) -> None:
    """Measure the estimator on one thread: a simulated trial in real time, frames beside it."""
    console = Console(markup=False)
    with console.status(f'simulating {seconds:g} s, then running them in real time'):
        report = measure(model, seconds, preset)
    _print(console, report)
    write_json(json, report)


def measure(model_name: str, seconds: float, preset: str) -> dict[str, Any]:
    """Return the figures, ready for JSON; those while contacts are found too under `contact`.

    Args:
        model_name: Weight file or name of a model.
        seconds: Length of the simulated trial [s].
        preset: Difficulty preset of the virtual sensor.

    Raises:
        ModelError: There is no such model.
    """
    model = read_model(find_model(model_name))
    estimator = FgerEstimator(model)
    scene = make_scene(seconds, preset)
    warm_up_codec()
    warm_up(estimator)
    alone, touched = (_figures(model, scene, each) for each in (None, ContactSettings()))
    return alone | {
        'contact': touched,
        'validity_share': validity_share(model, scene),
        'flops_per_cycle': operations_per_cycle(estimator.config),
        'parameters': count_parameters(estimator.config),
        'events_per_s': scene.events / seconds,
    }


def _figures(model: Model, scene: Scene, contact: ContactSettings | None) -> dict[str, Any]:
    frame_ms = frame_times_ms(model, scene, contact)
    paced = run_paced(model, scene, contact)
    calls = {name: quantiles(paced[name]) for name in ('step_ms', 'between_ms')}
    return paced | calls | {'frame_ms': quantiles(frame_ms), 'frames': len(frame_ms)}


def _print(console: Console, report: dict[str, Any]) -> None:
    names = {
        'step_ms': 'window step, packet decoded [ms]',
        'between_ms': 'packet between windows [ms]',
        'frame_ms': 'frame [ms]',
    }
    ways = {'': report, ', with contact': report['contact']}
    rows = [
        (name + way, *(f'{figures[key][part]:.3f}' for part in ('p50', 'p99')))
        for way, figures in ways.items()
        for key, name in names.items()
    ]
    title = 'One estimate, simulated trial in real time'
    console.print(make_table(title, ('figure', 'p50', 'p99'), rows))
    console.print(
        f'{report["parameters"]:,} parameters, {report["flops_per_cycle"] / 1e6:.1f} MFLOP per'
        f' 40 ms, at {report["events_per_s"] / 1e6:.2f} Mev/s; checks of validity take'
        f' {report["validity_share"]:.1%} of the time of windows'
    )
    for way, figures in ways.items():
        console.print(
            f'{figures["windows"]} forces{way}, {figures["late"]} of them more than 2 ms late,'
            f' {figures["frames_dropped"]} frames skipped, {figures["cpu"]:.0%} of a core,'
            f' {1e3 * figures["window_cpu_ms"]:.0f} us of processor time per window'
        )


if __name__ == '__main__':
    typer.run(infer)
