# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How well contacts are found: place, area, and when they begin and end, on simulated sensors.

Each unseen sensor is calibrated by one press beside a reference sensor, and its camera: optical
axis, and scale of the picture at the skin, wrong by 1 % (standard deviation). Then something
touches it at a place of another day, and on a third day something is pulled aside on it, where the
reference sensor tells the place by its torques.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

import numpy as np
import torch
import typer
from numpy.typing import NDArray
from rich.console import Console

from mixtac_cli.figures import make_table, progress_bar
from mixtac_cli.options import JsonFile, ModelName
from mixtac_fger.contact_tracking import ContactSettings
from mixtac_fger.displacement import SkinScale
from mixtac_fger.estimator import Estimate
from mixtac_fger.weights import DEFAULT_MODEL, Model, find_model, read_model
from mixtac_lab.experiments.sizes import PRESET
from mixtac_learning.judge.estimators import sensor_scales, stream, trial_estimator
from mixtac_learning.trials.simulated import SimulatedSource, arrays_of
from mixtac_node.files import write_json
from mixtac_sim.mechanics.elastomer import Layer, force_law
from mixtac_sim.optics.lens import Lens
from mixtac_sim.world.device import draw_conditions, draw_device
from mixtac_sim.world.effects import preset
from mixtac_sim.world.training_trials import TrialSpec, simulate
from mixtac_sim.world.trial import Trial

FIRST_DEVICE = 930_000
"""First seed of sensors and trials: beyond those of training and of the other studies."""
SCALE_DEVIATION = 0.01
"""Relative standard deviation of the scale that a calibration finds."""
SECONDS = 9.0
"""Length of a trial: two or three touches."""
PULLED_SECONDS = 5.0
"""Length of a trial in which what touches is pulled over the skin."""
PULLED_SHARE = 0.3
"""Pull over normal force from which on a contact counts as pulled."""
SMOOTH_S = 0.05
"""Time over which the torques of the reference sensor are averaged [s]: 0.1 mm at 0.5 N."""
EDGE_N = 0.03
"""True force at which a contact begins and ends [N]."""
SOON_US = 6000
"""Time within which the state is to follow [us]."""
LOWEST_N = 0.1
"""True force from which on place and area are judged; that from `EDGE_N` on is given beside."""
FORGET_US = 250_000
"""Edges that are not judged: closer to one before, as those of synchronising impulses [us]."""


class Touched(NamedTuple):
    """One trial; windows on the camera clock.

    Attributes:
        end_us: End of each window [n] [us].
        force: True force [n] [N].
        touching: State given out, bool [n].
        place_mm: Place given out, in the contact frame [n, 2]; NaN where none is.
        area_mm2: Area given out [n].
        true_place_mm: True place [2], or [n, 2]; NaN in windows that are not judged.
        true_area_mm2: True area [n].
    """

    end_us: NDArray[np.int64]
    force: NDArray[np.float64]
    touching: NDArray[np.bool_]
    place_mm: NDArray[np.float64]
    area_mm2: NDArray[np.float64]
    true_place_mm: NDArray[np.float64]
    true_area_mm2: NDArray[np.float64]


def px_per_mm(lens: Lens) -> float:
    """Return the scale of the picture at the skin on the optical axis [px/mm]."""
    return float(lens.image_distance_px / lens.distance_mm(0.0))


def true_area(spec: TrialSpec, trial: Trial, end_us: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the area of the contact at some times [us] of a trial [mm^2]."""
    level = preset(spec.preset)
    conditions = draw_conditions(spec.trial_seed, level)
    device = draw_device(spec.device_seed, level)
    layer = Layer(device.layer.modulus_kpa * conditions.stiffness, device.layer.thickness_mm)
    (tool,) = trial.profile.indenters
    law = force_law(layer, tool, device.mesh_n_per_mm, device.stiffening)
    depth = np.interp(end_us, trial.truth['t_us'], trial.truth['depth_mm'])
    radius = np.interp(depth, law.depths_mm, law.radius_mm)
    return np.asarray(np.pi * radius**2 * (depth > 0.0))


def felt_place(trial: Trial, end_us: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return where a reference sensor feels the contact [n, 2] [mm], NaN where little is pulled."""
    rate, offset_us = trial.clock
    stamps_us = (trial.reference_t_us - trial.reference_delay_us - offset_us) / rate
    step_s = 1e-6 * float(np.median(np.diff(stamps_us)))
    box = np.full(round(SMOOTH_S / step_s), step_s / SMOOTH_S)
    smooth = (np.convolve(each, box, 'same') for each in trial.reference_wrench.T)
    x, y, z, turn_x, turn_y, _ = (np.interp(end_us, stamps_us, each) for each in smooth)
    judged = (z > LOWEST_N) & (np.hypot(x, y) > PULLED_SHARE * z)
    # The wrench counts y downwards.
    place = 1e3 * np.stack([-turn_y, -turn_x], axis=1) / np.maximum(z, LOWEST_N)[:, None]
    return np.where(judged[:, None], place, np.nan)


def touch_sensor(model: Model, device: int, object_radius: float) -> tuple[Touched, Touched]:
    """Return how a calibrated sensor follows touches, and one that is pulled aside.

    Args:
        model: Content of a weight file.
        device: Seed of the sensor.
        object_radius: Radius of curvature that the sensor is told [mm]; 0 for none.
    """
    level = preset(PRESET)
    press = TrialSpec(device, device + 10_000, 'press', 8.0, PRESET)
    (gain,) = sensor_scales(trial_estimator(model), [SimulatedSource(press)], fallback=1.0).values()
    lens = draw_device(device, level).lens
    wrong = 1.0 + SCALE_DEVIATION * np.random.default_rng(device).normal()
    scale = SkinScale(wrong * px_per_mm(lens), SCALE_DEVIATION, lens.centre_px)
    contact = ContactSettings(object_radius=object_radius, scale=scale)

    def follow(spec: TrialSpec) -> tuple[Trial, Touched]:
        trial, found = simulate(spec), list[Estimate]()
        data = arrays_of(trial, {'name': spec.name})
        stream(model, data, observe=found.append, force_scale=gain, contact=contact)
        end_us = np.array([each.end_us for each in found], np.int64)
        shapes = [each.contact.shape if each.contact else None for each in found]
        none = (np.nan, np.nan, np.nan)
        rows = [none if s is None else (s.x_mm, s.y_mm, s.area_mm2) for s in shapes]
        table = np.array(rows, np.float64).reshape(-1, 3)
        right, down = draw_conditions(spec.trial_seed, level).contact_mm
        return trial, Touched(
            end_us,
            np.interp(end_us, trial.truth['t_us'], trial.truth['fz']),
            np.array([bool(each.contact and each.contact.touching) for each in found]),
            table[:, :2],
            table[:, 2],
            np.array([right, -down]),
            true_area(spec, trial, end_us),
        )

    _, touched = follow(TrialSpec(device, device + 20_000, 'touch', SECONDS, PRESET))
    trial, pulled = follow(TrialSpec(device, device + 30_000, 'slide', PULLED_SECONDS, PRESET))
    return touched, pulled._replace(true_place_mm=felt_place(trial, pulled.end_us))


def edges(state: NDArray[np.bool_], end_us: NDArray[np.int64]) -> dict[bool, NDArray[np.int64]]:
    """Return the times at which a state begins (True) and ends (False)."""
    change = np.diff(state.astype(np.int8))
    return {True: end_us[1:][change > 0], False: end_us[1:][change < 0]}


def edge_delays(trial: Touched) -> dict[bool, list[float]]:
    """Return how late the state follows the true force at each of its edges [ms].

    Negative where it is early; infinite where it does not follow within `FORGET_US`.
    """
    true = edges(trial.force > EDGE_N, trial.end_us)
    given = edges(trial.touching, trial.end_us)
    every = np.sort(np.concatenate([true[True], true[False]]))
    found: dict[bool, list[float]] = {True: [], False: []}
    for rising, times in true.items():
        for time in times.tolist():
            near = np.abs(every - time)
            if np.any((near > 0) & (near < FORGET_US)):
                continue
            late = given[rising] - time
            best = late[np.argmin(np.abs(late))] if len(late) else FORGET_US
            found[rising].append(1e-3 * best if abs(best) < FORGET_US else np.inf)
    return found


def place_error(trial: Touched) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the error of the place in each window [mm], and which are given at `LOWEST_N`."""
    error = np.hypot(*(trial.place_mm - trial.true_place_mm).T)
    return error, np.isfinite(error) & (trial.force > LOWEST_N)


def contact_rows(trials: list[Touched], pulled: list[Touched]) -> list[dict[str, Any]]:
    """Return the rows of the table: `what`, `value`, `target`, `unit` and `n`.

    Args:
        trials: Touches.
        pulled: Contacts that are pulled aside.
    """
    errors, areas, early = [], [], []
    for trial in trials:
        error, judged = place_error(trial)
        given = np.isfinite(error)
        errors.append(error[judged])
        early.append(error[given & (trial.force > EDGE_N) & (trial.force < LOWEST_N)])
        areas.append(trial.area_mm2[judged] / trial.true_area_mm2[judged] - 1.0)
    error, area = np.concatenate(errors), np.abs(np.concatenate(areas))
    light = np.concatenate(early)
    delays = [edge_delays(trial) for trial in trials]
    rows = [
        _row(f'place, from {LOWEST_N} N, median', np.median(error), 0.3, 'mm', len(error)),
        _row('place, 90 %', np.quantile(error, 0.9), None, 'mm', len(error)),
        _row('area, median error', np.median(area), 0.15, '', len(area)),
        _row('area, 90 %', np.quantile(area, 0.9), None, '', len(area)),
    ]
    if len(light):
        name = f'place, {EDGE_N} to {LOWEST_N} N, median'
        rows.insert(2, _row(name, np.median(light), 0.3, 'mm', len(light)))
    parts = (error[judged] for error, judged in map(place_error, pulled))
    aside = np.concatenate([np.empty(0), *parts])
    if len(aside):
        name = f'place, pulled by {PULLED_SHARE} of the force or more'
        rows.append(_row(f'{name}, median', np.median(aside), 0.3, 'mm', len(aside)))
        rows.append(_row(f'{name}, 90 %', np.quantile(aside, 0.9), None, 'mm', len(aside)))
    for rising, name in ((True, 'on'), (False, 'off')):
        late = np.concatenate([each[rising] for each in delays])
        soon = np.mean(np.abs(late) * 1e3 <= SOON_US)
        rows.append(_row(f'{name}, median delay', np.median(np.abs(late)), 6.0, 'ms', len(late)))
        rows.append(_row(f'{name}, within 6 ms', soon, None, '', len(late)))
    extra = sum(
        len(edges(trial.touching, trial.end_us)[True])
        - len(edges(trial.force > EDGE_N, trial.end_us)[True])
        for trial in trials
    )
    rows.append(_row('contacts given less true ones', extra, 0.0, '', len(trials)))
    return rows


def _row(what: str, value: float, target: float | None, unit: str, n: int) -> dict[str, Any]:
    return {'what': what, 'value': round(float(value), 4), 'target': target, 'unit': unit, 'n': n}


def contact_place(
    model: ModelName = DEFAULT_MODEL,
    sensors: Annotated[int, typer.Option(help='Number of unseen sensors.')] = 12,
    object_radius: Annotated[
        float, typer.Option(help='Radius of curvature that the sensor is told (mm); 0 for none.')
    ] = 9.0,
    quick: Annotated[bool, typer.Option('--quick', help='Three sensors.')] = False,
    json: JsonFile = None,
) -> None:
    """Show how well place, area, begin and end of contacts are found."""
    torch.set_num_threads(1)
    sensors = 3 if quick else sensors
    loaded = read_model(find_model(model))
    with progress_bar('touching', sensors) as advance:
        rows = contact_rows(*measure(loaded, sensors, object_radius, advance))
    shown = [(r['what'], f'{r["value"]:g} {r["unit"]}', r['target'], r['n']) for r in rows]
    headings = ('contact', 'found', 'wanted', 'of')
    Console(markup=False).print(make_table(f'contacts, {PRESET}, simulated', headings, shown))
    result = {'model': str(find_model(model)), 'simulated': True, 'object_radius': object_radius}
    write_json(json, {**result, 'sensors': sensors, 'rows': rows})


def measure(
    model: Model, sensors: int, object_radius: float, advance: Callable[[], None]
) -> tuple[list[Touched], list[Touched]]:
    """Return trials of some unseen sensors: touches, and pulls; `advance` is called after each."""
    touches, pulls = [], []
    for device in range(FIRST_DEVICE, FIRST_DEVICE + sensors):
        touched, pulled = touch_sensor(model, device, object_radius)
        touches.append(touched)
        pulls.append(pulled)
        advance()
    return touches, pulls
