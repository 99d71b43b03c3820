# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Faults of camera, lamp, optics and transport, put into simulated trials.

A fault is a change of the frames and events of a trial from some time on. `SEEN` faults were known
when the checks of the force were made. `UNSEEN` faults were written afterwards and tell what the
checks are worth for faults that nobody thought of. `faults` judges them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mixtac_events.arrays import Events
from mixtac_learning.trials.trial import TrialArrays

FULL_SCALE = 1023
"""Brightest value of a frame [DN]."""
Image = NDArray[np.uint16]
Random = np.random.Generator


@dataclass(slots=True)
class Stream:
    """A trial as it arrives; faults change it from `begin_us` on. Camera clock [us].

    Attributes:
        frames: Images, uint16, 0 to `FULL_SCALE`; None for one that does not arrive.
        mid_us: Centre of each exposure.
        arrival_us: Arrival of each frame.
        events: Events.
        begin_us: When the fault begins.
        random: For the fault's own choices.
        other: A trial of another sensor.
    """

    frames: list[Image | None]
    mid_us: NDArray[np.int64]
    arrival_us: NDArray[np.int64]
    events: Events
    begin_us: int
    random: Random
    other: TrialArrays

    @property
    def later(self) -> NDArray[np.bool_]:
        """Which events come after the start of the fault."""
        return self.events.t >= self.begin_us


def stream_of(trial: TrialArrays, begin_us: int, other: TrialArrays, seed: int = 0) -> Stream:
    """Return a trial without a fault."""
    middle = (trial.exposure_start_us + trial.exposure_end_us) // 2
    random = np.random.default_rng(seed)
    frames: list[Image | None] = list(np.minimum(trial.frames, np.uint16(FULL_SCALE)))
    return Stream(frames, middle, trial.arrival_us, trial.events, begin_us, random, other)


Fault = Callable[[Stream], None]


def _of_each_image(
    change: Callable[[NDArray[np.float64], Random, float], NDArray[np.floating]],
) -> Fault:
    """Return the fault that changes every image [DN], by the time since its begin [s], too."""

    def fault(stream: Stream) -> None:
        for index, (image, middle) in enumerate(zip(stream.frames, stream.mid_us, strict=True)):
            if image is not None and middle >= stream.begin_us:
                since_s = 1e-6 * float(middle - stream.begin_us)
                found = change(image.astype(np.float64), stream.random, since_s)
                stream.frames[index] = np.clip(found, 0, FULL_SCALE).astype(np.uint16)

    return fault


def of_images(change: Callable[[NDArray[np.float64], Random], NDArray[np.floating]]) -> Fault:
    """Return the fault that changes every image, given as float64 [DN]."""
    return _of_each_image(lambda image, random, _: change(image, random))


def of_events(change: Callable[[Events, Random], Events]) -> Fault:
    """Return the fault that changes the events after its begin."""

    def fault(stream: Stream) -> None:
        later = stream.later
        parts = [stream.events[~later], change(stream.events[later], stream.random)]
        events = Events.concatenate(parts)
        stream.events = events[np.argsort(events.t, kind='stable')]

    return fault


def both(*faults: Fault) -> Fault:
    """Return several faults at once."""

    def fault(stream: Stream) -> None:
        for each in faults:
            each(stream)

    return fault


def _frozen(stream: Stream) -> None:
    latest = None
    for index, middle in enumerate(stream.mid_us):
        if middle < stream.begin_us or latest is None:
            latest = stream.frames[index]
        stream.frames[index] = latest


def _frames_of_another(stream: Stream) -> None:
    for index, middle in enumerate(stream.mid_us):
        if middle >= stream.begin_us:
            theirs = stream.other.frames[index % len(stream.other.frames)]
            stream.frames[index] = np.minimum(theirs, np.uint16(FULL_SCALE))


def _frames_lost(period: int) -> Fault:
    """Lose all frames but one of each period; 0: all."""

    def fault(stream: Stream) -> None:
        for index, middle in enumerate(stream.mid_us):
            if middle >= stream.begin_us and not (period and index % period == 0):
                stream.frames[index] = None

    return fault


def _frames_in_a_loop(stream: Stream) -> None:
    chosen = [k for k, middle in enumerate(stream.mid_us) if middle >= stream.begin_us]
    loop = stream.frames[chosen[0] - 10 : chosen[0]]
    for place, index in enumerate(chosen):
        stream.frames[index] = loop[place % len(loop)]


def _events_in_a_loop(stream: Stream) -> None:
    length = 400_000
    events, begin = stream.events, stream.begin_us
    source = events.between(begin - length, begin)
    end = int(events.t[-1])
    copies = [source.shifted(shift) for shift in range(length, end - begin, length)]
    stream.events = Events.concatenate([events[~stream.later], *copies])


def _of_another(stream: Stream) -> None:
    theirs = stream.other.events[stream.other.events.t >= stream.begin_us]
    stream.events = Events.concatenate([stream.events[~stream.later], theirs])


def _late_events(late_us: int) -> Fault:
    return of_events(lambda events, _: events.shifted(late_us))


def _late_frames(late: int) -> Fault:
    """Return the fault that shows frames so many frames ago."""

    def fault(stream: Stream) -> None:
        shown = list(stream.frames)
        for index, middle in enumerate(stream.mid_us):
            if middle >= stream.begin_us and index >= late:
                stream.frames[index] = shown[index - late]

    return fault


def _fast_event_clock(stream: Stream) -> None:
    """Give the events later and later times."""
    begin = stream.begin_us

    def fast(events: Events, _: Random) -> Events:
        return replace(events, t=begin + (1.002 * (events.t - begin)).astype(np.int64))

    of_events(fast)(stream)


def _mixed_rows(stream: Stream) -> None:
    shown = list(stream.frames)
    for index, middle in enumerate(stream.mid_us):
        image, before = shown[index], shown[max(index - 1, 0)]
        if middle >= stream.begin_us and image is not None and before is not None:
            mixed = image.copy()
            mixed[1::2] = before[1::2]
            stream.frames[index] = mixed


def _every_second(events: Events, _: Random) -> Events:
    """Leave out every second event of each pixel, as with a threshold twice as high."""
    pixel = events.y.astype(np.int64) * 346 + events.x
    order = np.argsort(pixel, kind='stable')
    starts = np.flatnonzero(np.diff(pixel[order], prepend=-1))
    place = np.arange(len(events)) - np.repeat(starts, np.diff(starts, append=len(events)))
    kept = np.zeros(len(events), np.bool_)
    kept[order] = place % 2 == 0
    return events[kept]


def _in_time(change: Callable[[NDArray[np.float64], float], NDArray[np.floating]]) -> Fault:
    """Return the fault that changes every image by the time since its begin [s]."""
    return _of_each_image(lambda image, _, since_s: change(image, since_s))


def _losing_focus(image: NDArray[np.float64], since_s: float) -> NDArray[np.float64]:
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(image, 2.5 * min(since_s / 3.0, 1.0)))


def _creeping(image: NDArray[np.float64], since_s: float) -> NDArray[np.float64]:
    from scipy.ndimage import shift

    return np.asarray(shift(image, (0.0, since_s), order=1, mode='nearest'))


def _lit_from_one_side(image: NDArray[np.float64], since_s: float) -> NDArray[np.float64]:
    return image * (1.0 + 0.5 * min(since_s / 2.0, 1.0) * np.linspace(-1.0, 1.0, image.shape[1]))


def _smeared(image: NDArray[np.float64], _: Random) -> NDArray[np.float64]:
    y, x = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    return np.where((y - 150) ** 2 + (x - 200) ** 2 < 40**2, 0.7 * image, image)


def _striped_dead(image: NDArray[np.float64], _: Random) -> NDArray[np.float64]:
    image[100:120] = 0.0
    return image


def _shuffled_rows(events: Events, random: Random) -> Events:
    return replace(events, y=random.permutation(260)[events.y].astype(np.uint16))


def _part_of_events(share: float) -> Fault:
    return of_events(lambda events, random: events[random.random(len(events)) < share])


def _torn(image: NDArray[np.float64], _: Random) -> NDArray[np.float64]:
    return np.concatenate([image[130:], image[:130]])


def _striped(image: NDArray[np.float64], random: Random) -> NDArray[np.float64]:
    return image + random.normal(0.0, 150.0, (len(image), 1))


def _speckled(image: NDArray[np.float64], random: Random) -> NDArray[np.float64]:
    return np.where(random.random(image.shape) < 0.1, random.integers(0, 1024, image.shape), image)


def _dim(image: NDArray[np.float64], random: Random) -> NDArray[np.float64]:
    """Return a lamp at a fiftieth of its light, with the shot noise and steps of so little."""
    electrons = random.poisson(np.maximum(image * 0.02 * 10.0, 0.0))
    return np.asarray(electrons / 10.0 + random.normal(0.0, 1.0, image.shape))


def _blurred(image: NDArray[np.float64], _: Random) -> NDArray[np.float64]:
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(image, 6.0))


def _turned(image: NDArray[np.float64], _: Random) -> NDArray[np.float64]:
    from scipy.ndimage import rotate

    return np.asarray(rotate(image, 2.0, reshape=False, mode='nearest', order=1))


def _grown(image: NDArray[np.float64], _: Random) -> NDArray[np.float64]:
    from scipy.ndimage import affine_transform

    middle = np.array(image.shape) / 2.0
    return np.asarray(affine_transform(image, [0.96, 0.96], middle * 0.04, order=1, mode='nearest'))


def _covered(image: NDArray[np.float64], _: Random) -> NDArray[np.float64]:
    image[60:160, 90:200] = 180.0
    return image


def _drop(image: NDArray[np.float64], _: Random) -> NDArray[np.float64]:
    y, x = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    return np.asarray(image + 500.0 * np.exp(-((x - 120) ** 2 + (y - 90) ** 2) / 800.0))


def _moved(columns: int, rows: int = 0) -> Fault:
    """Return a camera that moved: frames and events."""

    def shift(events: Events, _: Random) -> Events:
        x = np.clip(events.x.astype(np.int64) + columns, 0, 345).astype(np.uint16)
        y = np.clip(events.y.astype(np.int64) + rows, 0, 259).astype(np.uint16)
        return replace(events, x=x, y=y)

    frames = of_images(lambda image, _: np.roll(image, (rows, columns), (0, 1)))
    return both(frames, of_events(shift))


def _mirrored_events(events: Events, _: Random) -> Events:
    return replace(events, x=(345 - events.x).astype(np.uint16))


def _events_upside_down(events: Events, _: Random) -> Events:
    return replace(events, y=(259 - events.y).astype(np.uint16))


def _brighter(events: Events, _: Random) -> Events:
    return replace(events, polarity=np.ones(len(events), np.bool_))


def _hot(events: Events, random: Random) -> Events:
    """Add 200 pixels that fire a thousand times a second."""
    first, last = int(events.t[0]), int(events.t[-1])
    count = int(200 * 1000.0 * 1e-6 * (last - first))
    places = random.integers(0, 346 * 260, 200)[random.integers(0, 200, count)]
    hot = Events(
        np.sort(random.integers(first, last, count)),
        (places % 346).astype(np.uint16),
        (places // 346).astype(np.uint16),
        np.ones(count, np.bool_),
    )
    return Events.concatenate([events, hot])


def _swapped(events: Events, _: Random) -> Events:
    x = np.minimum(events.y.astype(np.int64) * 346 // 260, 345)
    y = np.minimum(events.x.astype(np.int64) * 260 // 346, 259)
    return replace(events, x=x.astype(np.uint16), y=y.astype(np.uint16))


def _noise_storm(events: Events, random: Random) -> Events:
    count = int(0.4 * (events.t[-1] - events.t[0]))
    noise = Events(
        np.sort(random.integers(events.t[0], events.t[-1], count)),
        random.integers(0, 346, count).astype(np.uint16),
        random.integers(0, 260, count).astype(np.uint16),
        random.random(count) < 0.5,
    )
    return Events.concatenate([events, noise])


def _half_dark(image: NDArray[np.float64], _: Random) -> NDArray[np.float64]:
    image[:, :173] = np.minimum(image[:, :173], 4.0)
    return image


def _flat(value: float) -> Fault:
    return of_images(lambda image, random: random.normal(value, 2.0, image.shape))


SEEN: dict[str, Fault] = {
    'lamp at 2 %': of_images(_dim),
    'one LED dead': of_images(_half_dark),
    'all black': _flat(2.0),
    'all white': _flat(FULL_SCALE + 50.0),
    'frame frozen': _frozen,
    'camera moved by 1 px': _moved(1),
    'camera moved by 3 px': _moved(2, -2),
    'camera moved by 10 px': _moved(10),
    'frames mirrored': of_images(lambda image, _: image[:, ::-1]),
    'camera mirrored': both(
        of_images(lambda image, _: image[:, ::-1]), of_events(_mirrored_events)
    ),
    'no events': of_events(lambda events, _: events[:0]),
    'one polarity only': of_events(_brighter),
    '200 hot pixels': of_events(_hot),
    'another camera': both(_frames_of_another, _of_another),
    'no frames': _frames_lost(0),
    'picture inverted': of_images(lambda image, _: FULL_SCALE - image),
    'lens out of focus': of_images(_blurred),
    'lens covered in part': of_images(_covered),
    'stray light': of_images(lambda image, _: image + 300.0),
    'events mirrored': of_events(_mirrored_events),
    'polarity inverted': of_events(lambda events, _: replace(events, polarity=~events.polarity)),
    'columns and rows of events swapped': of_events(_swapped),
    'events in a loop': _events_in_a_loop,
    'events late by 30 ms': _late_events(30_000),
    'events of the left half': of_events(lambda events, _: events[events.x < 173]),
    'noise of 0.4 Mev/s': of_events(_noise_storm),
    'exposure 5 times': of_images(lambda image, _: image * 5.0),
    'focus lost within 3 s': _in_time(_losing_focus),
    'frames late by 3': _late_frames(3),
    'events of every other row': of_events(lambda events, _: events[events.y % 2 == 0]),
    'events twice': of_events(lambda events, _: events[np.repeat(np.arange(len(events)), 2)]),
    'event times in steps of 10 ms': of_events(
        lambda events, _: replace(events, t=events.t // 10_000 * 10_000)
    ),
}
"""Faults that were known when the checks were made."""
UNSEEN: dict[str, Fault] = {
    'frame torn': of_images(_torn),
    'row noise': of_images(_striped),
    'a tenth of the pixels random': of_images(_speckled),
    'picture turned by 2 degrees': of_images(_turned),
    'picture grown by 4 %': of_images(_grown),
    'drop on the lens': of_images(_drop),
    'frames of another sensor': _frames_of_another,
    'frames in a loop': _frames_in_a_loop,
    'a tenth of the events': _part_of_events(0.1),
    'upside down': both(
        of_images(lambda image, _: image[::-1]),
        of_events(_events_upside_down),
    ),
    'two bits lost': of_images(lambda image, _: np.mod(image * 4.0, 1024.0)),
    'events late by 10 ms': _late_events(10_000),
    'events of another sensor': _of_another,
    'events shifted by 5 px': of_events(
        lambda events, _: replace(events, x=np.minimum(events.x + 5, 345).astype(np.uint16))
    ),
    'events turned by 180 degrees': both(
        of_events(_mirrored_events), of_events(_events_upside_down)
    ),
    'rows of events shuffled': of_events(_shuffled_rows),
    'polarity at random': of_events(
        lambda events, random: replace(events, polarity=random.random(len(events)) < 0.5)
    ),
    'half of the events': _part_of_events(0.5),
    'frames late by 1': _late_frames(1),
    'frames upside down': of_images(lambda image, _: image[::-1]),
    'noise of frames 5 times': of_images(
        lambda image, random: image + random.normal(0.0, 15.0, image.shape)
    ),
    'light to 60 % at once': of_images(lambda image, _: image * 0.6),
    'light fades by 10 % per s': _in_time(lambda image, since_s: image * np.exp(-0.1 * since_s)),
    'light from one side': _in_time(_lit_from_one_side),
    'camera creeps by 1 px per s': _in_time(_creeping),
    'stripe of 20 rows dead': of_images(_striped_dead),
    'beads fade': of_images(lambda image, _: image.mean() + 0.4 * (image - image.mean())),
    'smear on the lens': of_images(_smeared),
    'every fourth column of events silent': of_events(lambda events, _: events[events.x % 4 > 0]),
    'one bit of the columns of events 0': of_events(
        lambda events, _: replace(events, x=events.x & np.uint16(0xFFEF))
    ),
    'half of the ON events': of_events(
        lambda events, random: events[~events.polarity | (random.random(len(events)) < 0.5)]
    ),
    'every second event of a pixel': of_events(_every_second),
    'event times wrong by 0 to 5 ms': of_events(
        lambda events, random: replace(events, t=events.t + random.integers(0, 5000, len(events)))
    ),
    'event clock 0.2 % fast': _fast_event_clock,
    'two of three frames lost': _frames_lost(3),
    'every second row one frame late': _mixed_rows,
    'gains of columns': of_images(
        lambda image, _: image * np.random.default_rng(5).normal(1.0, 0.03, image.shape[1])
    ),
}
"""Faults that were written after the thresholds were set; no check was made with them."""
