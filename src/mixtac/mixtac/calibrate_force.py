# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac calibrate-force`: options, result, weight file and picture."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Optional

import numpy as np
import typer
from rich.console import Console

from mixtac.figures import FORCE, make_table, new_axes, save_figure
from mixtac.figures import REFERENCE as KNOWN
from mixtac.loads import LiveProcedure, Session, from_bag
from mixtac.options import JsonFile, Namespace, OptionalPath, ParamsFile, ReferenceTopic
from mixtac.up import start_nodes
from mixtac_core.node.files import write_json
from mixtac_core.node.graph import is_virtual, sensor_graph
from mixtac_core.node.process import ProcessGroup
from mixtac_core.node.topics import DEFAULT_NAMESPACE, REFERENCE
from mixtac_fger.config import ModelError
from mixtac_fger.estimator import CALIBRATED_KEY, SERIAL_KEY
from mixtac_fger.fger_net import (
    CALIBRATED_DEVIATION,
    checked_config,
    with_gain,
    with_sideways_gain,
)
from mixtac_fger.force_calibration import (
    PULL,
    ForceCalibration,
    ForceCalibrationError,
    Load,
    check_loads,
    fit_gain,
    load_of,
    sideways_gain,
)
from mixtac_fger.weights import (
    DEFAULT_MODEL,
    SUFFIX,
    Model,
    ModelCard,
    find_model,
    read_model,
    save_model,
)

DEFAULT_LOADS = '20,50,100'
"""Loads that are asked for unless others are named [g]."""
CHECK_LOADS = '50'
"""Loads of `--check` unless others are named [g]."""
LOAD_SD_G = 1.0
"""Standard uncertainty of a household weight [g]."""
SCALE_SD_G = 2.0
"""Standard uncertainty of a hand on a kitchen scale [g]."""
SESSION_S = 1200.0
"""Longest procedure [s]."""


def calibrate_force(
    device: Annotated[str, typer.Option(help='davis346 or virtual.')] = 'davis346',
    loads: Annotated[
        str,
        typer.Option(
            help='Loads (g) in the order of application, such as 20,50,100. If empty, a reference '
            'force sensor is used if one publishes, else 20,50,100 (50 with --check).'
        ),
    ] = '',
    sideways_loads: Annotated[
        str,
        typer.Option(
            help='Loads (g) on a thread, such as 20, that pull the largest other load sideways, '
            'for the sideways force. In a recording, they are in the last contact.'
        ),
    ] = '',
    scale: Annotated[
        bool,
        typer.Option('--scale', help='Without weights: press until a kitchen scale shows a load.'),
    ] = False,
    load_sd: Annotated[
        Optional[float],  # noqa: UP045  (typer evaluates this under Python 3.10)
        typer.Option(min=0, help='Standard uncertainty of a load (g); 1, or 2 with --scale.'),
    ] = None,
    model: Annotated[
        str, typer.Option(help='Model to calibrate: weight file, or name of a shipped model.')
    ] = DEFAULT_MODEL,
    out: Annotated[
        OptionalPath, typer.Option(help='Weight file (.safetensors) to write, with a model card.')
    ] = None,
    gel: Annotated[str, typer.Option(help='Name of the gel, for the model card.')] = '',
    check: Annotated[
        bool,
        typer.Option('--check', help='Check a calibrated --model with known loads; write nothing.'),
    ] = False,
    bag: Annotated[
        OptionalPath,
        typer.Option(help='Recording of the procedure to use instead of a sensor.', exists=True),
    ] = None,
    yes: Annotated[
        bool,
        typer.Option('--yes', help='Do not wait for the Enter key; operate the virtual sensor.'),
    ] = False,
    reference: ReferenceTopic = REFERENCE,
    json: JsonFile = None,
    figure: Annotated[OptionalPath, typer.Option(help='Draw the result to this file.')] = None,
    namespace: Namespace = DEFAULT_NAMESPACE,
    params_file: ParamsFile = None,
) -> None:
    """Calibrate the force of a sensor with weights or a kitchen scale, without a force sensor."""
    start = find_model(model)
    content = read_model(start)
    relative_sd = _checked(content, start, out, check=check, sideways=bool(sideways_loads))
    sd_g = load_sd if load_sd is not None else SCALE_SD_G if scale else LOAD_SD_G
    known = parse_loads(loads or (CHECK_LOADS if check else DEFAULT_LOADS), sd_g)
    pulls = parse_loads(sideways_loads, sd_g) if sideways_loads else []
    if not check:
        check_loads(known)
    console = Console(markup=False, highlight=False)
    if bag is not None:
        session = from_bag(bag, content, known, '' if loads else reference, pulls)
    else:
        procedure = {'loads': known, 'pulls': pulls, 'known': bool(loads), 'scale': scale}
        session = lead_live(console, namespace, device, start, params_file, yes=yes, **procedure)
    if scale and session.known_by == 'weights':
        session.known_by = 'scale'
    for doubt in session.doubts:
        console.print(f'warning: {doubt}', style='yellow')
    facts = {'model': str(start), 'device': device, 'serial': session.serial}
    if check:
        _check(console, session, relative_sd, facts, json)
        return
    assert out is not None  # noqa: S101  (checked above)
    check_loads(session.loads)
    normal = fit_gain(session.loads, session.plateaus)
    entry = {
        'date': dt.datetime.now(dt.timezone.utc).strftime('%Y-%m-%d'),
        'serial': session.serial,
        'gel': gel,
        'from': start.name,
        'known_by': session.known_by,
    } | _entry(normal)
    _report(console, 'Known loads', entry)
    # Deviations become those of a known gain once.
    once = CALIBRATED_KEY not in content.card.training
    scaled = with_gain(content, normal.gain, CALIBRATED_DEVIATION if once else 1.0)
    if session.pulls:
        pulled = fit_gain(session.pull_loads, session.pulls, PULL)
        gain, gain_sd = sideways_gain(pulled, normal.gain)
        aside = _entry(pulled)
        _report(console, 'Known pulls', aside)
        console.print(
            f'sideways gain of the weight file {gain:.3f} +- {gain_sd:.3f}, expected elsewhere'
        )
        # Weight files hold the sideways gain beside that of the normal force.
        beside = {'pulled_gain': pulled.gain, 'pulled_gain_sd': pulled.gain_sd}
        beside |= {'gain': gain, 'gain_sd': gain_sd}
        entry['sideways'] = aside | {k: round(v / normal.gain, 5) for k, v in beside.items()}
        scaled = with_sideways_gain(scaled, gain / normal.gain)
    # The weights first: the procedure took its time.
    training = content.card.training | {CALIBRATED_KEY: entry}
    if session.serial:
        training[SERIAL_KEY] = session.serial
    save_model(out, replace(scaled, card=ModelCard(training, content.card.metrics)))
    console.print(f'wrote {out}; name it as `model` of fger in a parameter file')
    write_json(json, facts | {'out': str(out)} | entry)
    if figure is not None:
        draw(figure, session, normal, entry)
        console.print(f'drawn: {figure}')


def lead_live(
    console: Console,
    namespace: str,
    device: str,
    model: Path,
    params_file: Path | None,
    *,
    yes: bool,
    **procedure: Any,  # noqa: ANN401
) -> Session:
    """Start a sensor, guide the user through the loads, and stop the sensor.

    Args:
        console: Where to prompt.
        namespace: ROS namespace of the sensor.
        device: As for `mixtac up`.
        model: Weight file of the estimator.
        params_file: Parameter file of the nodes.
        yes: Do not wait for the Enter key; operate the virtual sensor.
        procedure: Arguments of `LiveProcedure.lead`.

    Raises:
        ForceCalibrationError: The measured loads do not allow a calibration.
        GraphError: A node failed.
    """
    from mixtac.monitor_node import Monitor

    # The prompts ask for an untouched sensor. The model is measured, whatever the file sets, and
    # forces that are not valid count, as in a recording: loads reveal wrong ones.
    estimator: dict[str, object] = {'model': str(model.resolve()), 'assume_free': True}
    estimator |= {'force_scale': 1.0, 'sideways_scale': 1.0}
    estimator |= {'invalid_force': 'publish', 'tare_on_release': False}
    nodes = sensor_graph(device, estimator=estimator)
    console.print('starting the sensor; a first start compiles for some minutes')
    with ProcessGroup() as processes, Monitor(namespace, processes, SESSION_S) as monitor:
        start_nodes(processes, nodes, namespace, params_file, 'warn')
        monitor.bring_up_all(nodes)
        monitor.listen()
        monitor.wait_for_force()
        drives = yes and is_virtual(device)
        return LiveProcedure(console, monitor, yes=yes, drives=drives).lead(**procedure)


def parse_loads(text: str, sd_grams: float) -> list[Load]:
    """Return the loads of a text like `20,50,100`, in grams.

    Args:
        text: Masses, separated by commas [g].
        sd_grams: Standard uncertainty of each [g].

    Raises:
        ForceCalibrationError: A mass is not a number above 0.
    """
    try:
        grams = [float(part) for part in text.split(',')]
    except ValueError:
        grams = []
    if not grams or not all(0.0 < each < float('inf') for each in grams):
        raise ForceCalibrationError(
            f'loads {text!r} are not grams', 'loads', 'give them like 20,50,100'
        )
    return [load_of(each, sd_grams) for each in grams]


def _checked(content: Model, path: Path, out: Path | None, *, check: bool, sideways: bool) -> float:
    """Check all options before the procedure; return the relative uncertainty in the card."""
    config = checked_config(content)
    if sideways and (check or not config.shear):
        why = 'is checked by its normal force alone' if check else 'gives no sideways force'
        raise ModelError(f'{path} {why}', remedy='give no --sideways-loads')
    if check:
        found = content.card.training.get(CALIBRATED_KEY)
        if not isinstance(found, dict):
            raise ModelError(
                f'{path} was not calibrated, so there is nothing to check',
                remedy='give the weight file that calibrate-force wrote as --model',
            )
        return float(found['gain_sd']) / float(found['gain'])
    if out is None or out.suffix != SUFFIX:
        raise ModelError(
            f'{out or "no file"} is not a weight file to write',
            remedy=f'give --out a name that ends in {SUFFIX}',
        )
    return 0.0


def _entry(calibration: ForceCalibration) -> dict[str, Any]:
    """Return the fields of a fit for the model card and the JSON file."""
    points = calibration.points
    before = [abs(load.force_n - plateau.size_n) for load, plateau, *_ in points]
    return {
        'gain': round(calibration.gain, 5),
        'gain_sd': round(calibration.gain_sd, 5),
        'mae_before_n': round(float(np.mean(before)), 4),
        'mae_after_n': round(float(np.mean([abs(each.residual_n) for each in points])), 4),
        'loads': [
            {
                'load_g': round(load.grams, 2),
                'load_n': round(load.force_n, 4),
                'load_sd_n': round(load.sd_n, 4),
                'estimate_n': round(plateau.size_n, 4),
                'residual_n': round(residual, 4),
                'allowed_n': round(allowed, 4),
                'sd_n': round(plateau.span.sd_n, 4),
                'creep_n_per_s': round(abs(plateau.span.creep_n_per_s), 4),
                'zero_shift_n': round(plateau.left_n, 4),
            }
            for load, plateau, residual, allowed in points
        ],
    }


SHOWN = ('load_g', 'load_n', 'estimate_n', 'residual_n', 'creep_n_per_s', 'zero_shift_n')
"""Columns of the table."""
DOUBTFUL = 0.67
"""Share of the largest residual that can be explained, from which the user is warned."""


def _report(console: Console, title: str, entry: dict[str, Any]) -> None:
    rows = [[f'{load[name]:.3f}' for name in SHOWN] for load in entry['loads']]
    console.print(make_table(f'{title}; forces in N', SHOWN, rows))
    for load in entry['loads']:
        if abs(load['residual_n']) > DOUBTFUL * load['allowed_n']:
            grams = f'{load["load_g"]:.1f} g'
            console.print(
                f'warning: {grams} fit the other loads badly; check them, or put them on again'
            )
    console.print(
        f'gain {entry["gain"]:.3f} +- {entry["gain_sd"]:.3f} (one standard deviation); mean error'
        f' {entry["mae_before_n"]:.3f} N before, {entry["mae_after_n"]:.3f} N after'
    )


CHECK_TOLERANCE = 0.1
"""Relative change that another place on the gel and another day make (simulated: 0.06)."""


def _check(
    console: Console,
    session: Session,
    relative_sd: float,
    facts: dict[str, Any],
    json: Path | None,
) -> None:
    """Print whether a calibrated sensor still reads known loads.

    Raises:
        ForceCalibrationError: The sensor does not.
    """
    checks = []
    for load, plateau in zip(session.loads, session.plateaus, strict=True):
        fit = fit_gain([load], [plateau])
        allowed = CHECK_TOLERANCE + 2.0 * float(np.hypot(fit.gain_sd, relative_sd))
        passed = abs(fit.gain - 1.0) <= allowed
        checks.append(
            {'ratio': fit.gain, 'ratio_sd': fit.gain_sd, 'allowed': allowed, 'passed': passed}
        )
        console.print(
            f'{load.grams:.1f} g: known {load.force_n:.3f} N, estimated {plateau.size_n:.3f} N;'
            f' ratio {fit.gain:.3f} +- {fit.gain_sd:.3f}, {1.0 - allowed:.2f} to'
            f' {1.0 + allowed:.2f} pass: {"pass" if passed else "FAIL"}'
        )
    passed = all(each['passed'] for each in checks)
    write_json(json, facts | {'passed': passed, 'checks': checks})
    if not passed:
        raise ForceCalibrationError(
            'the sensor no longer reads the known loads',
            'loads',
            'look at gel, lamp and mount, then calibrate it again',
        )


def draw(
    path: Path, session: Session, calibration: ForceCalibration, entry: dict[str, Any]
) -> None:
    """Draw the force before and after the calibration, and the known loads.

    Args:
        path: File to write; its suffix gives the format.
        session: Series and plateaus.
        calibration: The fit.
        entry: Entry of the fit in the model card.

    Raises:
        FileError: The picture cannot be written.
    """
    gain, sd = calibration.gain, calibration.gain_sd
    title = f'{entry["serial"] or "sensor"}: gain {gain:.3f} +- {sd:.3f}, {entry["date"]}'
    figure, (axes,) = new_axes()
    axes.set_title(title, loc='left')
    axes.plot(session.t_s, session.force_n, color=FORCE, alpha=0.4, lw=0.6, label='estimate')
    axes.plot(session.t_s, gain * session.force_n, color=FORCE, lw=0.8, label='calibrated')
    for load, plateau in zip(session.loads, session.plateaus, strict=True):
        axes.hlines(load.force_n, *plateau.span[:2], color=KNOWN, lw=2)
    axes.set(xlabel='time [s]', ylabel='normal force [N]')
    axes.legend(loc='upper left', frameon=False)
    save_figure(figure, path)
