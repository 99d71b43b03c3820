# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Statistics of recordings of real cameras beside those of the virtual sensor.

Scenes differ, so only what a scene decides little is compared; the rest shows what there was to
see. Noise is taken from isolated events: those with no other event in the eight pixels around them
within 10 ms before or after. Among moving things they are an upper bound.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numba import njit
from numpy.typing import NDArray
from rich.console import Console

from mixtac_cli.figures import make_table
from mixtac_cli.options import JsonFile, Preset
from mixtac_driver.pixels import hot_pixels
from mixtac_events.arrays import Events
from mixtac_node.files import write_json
from mixtac_recordings.camera_stream import open_recording
from mixtac_sim.grids import HEIGHT, WIDTH
from mixtac_sim.world import effects
from mixtac_sim.world.instruments import InertialUnit
from mixtac_sim.world.profiles import make_profile
from mixtac_sim.world.sensor import TactileSensor

ISOLATED_US = 10_000
HOT_HZ, HOT_FACTOR = 10.0, 10.0
CLIP = 40.0
"""Differences of frames beyond this are motion [counts of 10 bits]."""
SMOOTH = 51
"""Samples of the running mean of inertial samples: slower motion is not noise."""
DEVICE_SEED, SEED = 1001, 1001
SCENES = ('idle', 'dynamic', 'slide')
"""Profiles of the virtual sensor: at rest, pressed at all paces, pulled over the skin."""
COMPARED = (
    'isolated [1/s/px]',
    'ON / OFF',
    'row length',
    'interval p01 [ms]',
    'frame noise',
    'frame interval [ms]',
    'IMU rate [Hz]',
    'accelerometer noise [m/s^2]',
    'gyroscope noise [rad/s]',
)
"""Figures that a scene decides little."""


@njit(cache=True, nogil=True)
def _isolated(t: Any, x: Any, y: Any, width: int, height: int, window_us: int) -> Any:  # noqa: ANN401
    last = np.full((height + 2, width + 2), -(1 << 60), np.int64)
    number = np.full((height + 2, width + 2), -1, np.int64)
    alone = np.ones(len(t), np.bool_)
    for i in range(len(t)):
        row, column = int(y[i]) + 1, int(x[i]) + 1
        for a in range(row - 1, row + 2):
            for b in range(column - 1, column + 2):
                if (a != row or b != column) and t[i] - last[a, b] <= window_us:
                    alone[i] = False
                    alone[number[a, b]] = False
        last[row, column] = t[i]
        number[row, column] = i
    return alone


def of_events(events: Events, size: tuple[int, int]) -> dict[str, float]:
    """Return the statistics of events; NaN where there are too few.

    Args:
        events: Events sorted by time.
        size: Width and height of the pixel array.
    """
    names = (
        *('events [1/s]', 'ON / OFF', 'silent pixels', 'hot pixels', 'isolated [1/s/px]'),
        *('row length', 'interval p01 [ms]', 'interval p50 [ms]'),
    )
    if len(events) < 2 or events.t[-1] <= events.t[0]:
        return dict.fromkeys(names, math.nan)
    width, height = size
    seconds = float(events.t[-1] - events.t[0]) / 1e6
    pixel = events.y.astype(np.int64) * width + events.x
    counts = np.bincount(pixel, minlength=width * height).reshape(height, width)
    hot = hot_pixels(counts, seconds, HOT_HZ, HOT_FACTOR)
    is_hot = np.zeros(counts.shape, np.bool_)
    for column, row in hot:
        is_hot[row, column] = True
    cool = ~is_hot[events.y, events.x]
    rest = events[cool]
    alone = _isolated(rest.t, rest.x, rest.y, width, height, ISOLATED_US)
    # On the wire a row word holds for all events of that row and time; here x is the row.
    begins = np.diff(events.t, prepend=-1) != 0
    begins |= np.diff(events.x.astype(np.int64), prepend=-1) != 0
    order = np.lexsort((rest.t, pixel[cool]))
    steps = np.diff(rest.t[order])[np.diff(pixel[cool][order]) == 0]
    p01, p50 = np.quantile(steps, (0.01, 0.5)) / 1000 if len(steps) else (math.nan, math.nan)
    on = int(events.polarity.sum())
    figures = (
        *(len(events) / seconds, on / max(len(events) - on, 1), float((counts == 0).mean())),
        *(len(hot), int(alone.sum()) / seconds / counts.size, len(events) / int(begins.sum())),
        *(float(p01), float(p50)),
    )
    return dict(zip(names, figures, strict=True))


def of_frames(images: list[NDArray[np.uint16]], starts_us: list[int]) -> dict[str, float]:
    """Return interval and noise of frames; NaN where there are too few.

    Args:
        images: Frames of equal size, 0 .. 1023.
        starts_us: Start of each exposure [us].
    """
    interval = noise = math.nan
    if len(images) > 1:
        interval = float(np.median(np.diff(starts_us))) / 1000
        parts = []
        # Other drivers keep eight of the ten bits.
        coarse = [image & ~np.uint16(3) for image in images]
        for before, after in pairwise(coarse):
            inside = (before > 0) & (after > 0) & (before < 1000) & (after < 1000)
            step = after[inside].astype(float) - before[inside]
            still = step[np.abs(step) < CLIP]
            parts.append(float(still.std()) / math.sqrt(2.0) if len(still) else math.nan)
        noise = float(np.nanmedian(parts))
    return {'frame interval [ms]': interval, 'frame noise': noise}


def of_samples(
    t: NDArray[np.int64], acceleration: NDArray[np.float64], rate: NDArray[np.float64]
) -> dict[str, float]:
    """Return rate and noise of inertial samples; NaN where there are too few.

    Args:
        t: Times [us].
        acceleration: [n, 3] [m/s^2].
        rate: [n, 3] [rad/s].
    """
    hz = noise = turning = math.nan
    if len(t) > 2:
        hz = 1e6 / float(np.median(np.diff(t)))
        noise, turning = (_restless(each) for each in (acceleration, rate))
    return {
        'IMU rate [Hz]': hz,
        'accelerometer noise [m/s^2]': noise,
        'gyroscope noise [rad/s]': turning,
    }


def _restless(values: NDArray[np.float64]) -> float:
    """Return the deviation from a running mean, the mean of the axes of [n, 3]."""
    window = np.ones(SMOOTH) / SMOOTH
    if len(values) < 2 * SMOOTH:
        return math.nan
    slow = np.stack([np.convolve(column, window, 'valid') for column in values.T], axis=1)
    at = SMOOTH // 2
    return float((values[at : at + len(slow)] - slow).std(axis=0).mean())


def of_recording(path: Path) -> dict[str, float]:
    """Return the statistics of a recording.

    Raises:
        RecordingError: It cannot be read.
    """
    parts, images, starts, samples = [], [], [], []
    with closing(open_recording(path)) as recording:
        size = recording.info.width, recording.info.height
        for piece in recording.pieces(0):
            parts.append(piece.events.copy())
            images += [frame.image for frame in piece.frames]
            starts += [frame.exposure_start_us for frame in piece.frames]
            samples.append(piece.imu)
    found = of_events(Events.concatenate(parts), size) | of_frames(images, starts)
    t = np.concatenate([each.t for each in samples])
    acceleration = np.concatenate([each.acceleration for each in samples])
    rates = np.concatenate([each.angular_velocity for each in samples])
    return found | of_samples(t, acceleration, rates)


def of_virtual_sensor(scene: str, seconds: float, preset: effects.Preset) -> dict[str, float]:
    """Return the statistics of the virtual sensor.

    Args:
        scene: Profile, as of `mixtac_sim.world.profiles.make_profile`.
        seconds: Length [s].
        preset: Difficulty of the sensor.
    """
    profile = make_profile(scene, SEED, seconds, preset=preset)
    output = TactileSensor(DEVICE_SEED, SEED, profile, preset=preset).advance(round(1e6 * seconds))
    images = [frame.intensity for frame in output.frames]
    starts = [frame.exposure_start_us for frame in output.frames]
    unit = InertialUnit(DEVICE_SEED)
    unit.feel(output.wrench_us, output.wrench)
    readings = unit.readings(round(1e6 * seconds), 1000)
    t = np.array([r.t_us for r in readings], np.int64)
    acceleration = 9.80665 * np.array([r.acceleration_g for r in readings]).reshape(-1, 3)
    rates = np.radians(np.array([r.rate_dps for r in readings]).reshape(-1, 3))
    found = of_events(output.events, (WIDTH, HEIGHT)) | of_frames(images, starts)
    return found | of_samples(t, acceleration, rates)


def far_apart(
    real: Iterable[Mapping[str, float]], virtual: Iterable[Mapping[str, float]]
) -> dict[str, float]:
    """Return by which factor the ranges of figures are apart, where by more than two.

    Args:
        real: Statistics of recordings.
        virtual: Statistics of the virtual sensor.
    """
    real, virtual, found = list(real), list(virtual), {}
    for name in COMPARED:
        sides = [
            [each[name] for each in side if math.isfinite(each[name]) and each[name] > 0]
            for side in (real, virtual)
        ]
        if all(sides):
            low, high = sides
            factor = max(min(high) / max(low), min(low) / max(high), 1.0)
            if factor > 2.0:
                found[name] = factor
    return found


def realism(
    recordings: Annotated[
        list[Path], typer.Argument(help='Recordings: folders of bags, .mcap, .db3 or .aedat4.')
    ],
    seconds: Annotated[
        float, typer.Option(min=2, max=600, help='Length of each simulated scene (s).')
    ] = 6.0,
    preset: Preset = 'easy',
    json: JsonFile = None,
) -> None:
    """Compare the statistics of real recordings with those of the virtual sensor."""
    console = Console(markup=False)
    real = {path.name: of_recording(path) for path in recordings}
    chosen = effects.preset(preset)
    virtual = {f'virtual, {scene}': of_virtual_sensor(scene, seconds, chosen) for scene in SCENES}
    columns = real | virtual
    names = list(next(iter(columns.values())))
    rows = [
        (name, *(_shown(each[name]) for each in columns.values()), _mark(name)) for name in names
    ]
    letters = [chr(ord('A') + k) for k in range(len(real))]
    console.print(make_table('statistics', ('', *letters, *SCENES, 'compared'), rows))
    for letter, name in zip(letters, real, strict=True):
        console.print(f'{letter}: {name}')
    console.print(f'{", ".join(SCENES)}: the virtual sensor, simulated')
    apart = far_apart(real.values(), virtual.values())
    for name, factor in apart.items():
        console.print(f'{name}: apart by a factor of {factor:.1f}')
    if not apart:
        console.print('no figure that can be compared is apart by more than a factor of two')
    result: dict[str, Any] = {
        'statistics': {
            column: {k: v if math.isfinite(v) else None for k, v in each.items()}
            for column, each in columns.items()
        },
        'apart': apart,
        'preset': preset,
        'seconds': seconds,
    }
    write_json(json, result)


def _shown(value: float) -> str:
    return f'{value:.3g}' if math.isfinite(value) else '-'


def _mark(name: str) -> str:
    return 'yes' if name in COMPARED else ''
