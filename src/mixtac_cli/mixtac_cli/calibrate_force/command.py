# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac calibrate-force`: options, result, weight file and picture."""

from __future__ import annotations

import datetime as dt
from pathlib import Path
from typing import Annotated, Any, Optional

import numpy as np
import typer
from rich.console import Console

from mixtac_cli.calibrate_force.live import LiveProcedure
from mixtac_cli.calibrate_force.session import Session, from_bag
from mixtac_cli.figures import FORCE, MARK, make_table, new_figure, save_figure
from mixtac_cli.figures import REFERENCE as KNOWN
from mixtac_cli.options import JsonFile, Namespace, OptionalPath, ParamsFile, ReferenceTopic
from mixtac_fger.config import ModelError
from mixtac_fger.estimator import ADAPTED_KEY, CALIBRATED_KEY, SERIAL_KEY
from mixtac_fger.force_calibration import (
    DOUBT,
    ForceCalibration,
    ForceCalibrationError,
    check_gain,
    check_loads,
    fit_gain,
    load_of,
)
from mixtac_fger.pull_calibration import PullCalibration, fit_pulls, parse_pulls
from mixtac_fger.weights import DEFAULT_MODEL, SUFFIX, Model, ModelCard, find_model, read_model
from mixtac_node.files import write_json
from mixtac_node.topics import DEFAULT_NAMESPACE, REFERENCE

DEFAULT_LOADS, CHECK_LOADS = '20,50,100', '50'
LOAD_SD_G, SCALE_SD_G = 1.0, 2.0
"""Standard uncertainty of a load unless it is stated: household weights, a hand on a scale [g]."""


def calibrate_force(
    device: Annotated[str, typer.Option(help='davis346 or virtual.')] = 'davis346',
    loads: Annotated[
        str,
        typer.Option(
            help='Loads (g) in their order, such as 20,50,100. A smaller one after a larger one is '
            'reached by taking weight off. If empty, a reference force sensor is used if one '
            'publishes, else 20,50,100 (50 with --check).'
        ),
    ] = '',
    sideways_loads: Annotated[
        str,
        typer.Option(
            help='Loads (g) that pull the largest of the others aside, for the sideways force: 20'
            ' for 20 g towards +x, -x, +y and -y of the contact frame, or +x:20,-y:30. Last contact'
            ' of a recording.'
        ),
    ] = '',
    scale: Annotated[
        bool,
        typer.Option('--scale', help='Press until a kitchen scale shows the grams: no weights.'),
    ] = False,
    load_sd: Annotated[
        Optional[float],  # noqa: UP045  (typer evaluates this under Python 3.10)
        typer.Option(min=0, help='Standard uncertainty of a load (g); 1, or 2 with --scale.'),
    ] = None,
    model: Annotated[
        str, typer.Option(help='Model to calibrate: a weight file or the name of a shipped one.')
    ] = DEFAULT_MODEL,
    out: Annotated[
        OptionalPath, typer.Option(help='Weight file to write (.safetensors), with a card.')
    ] = None,
    gel: Annotated[str, typer.Option(help='Name of the gel, for the card.')] = '',
    check: Annotated[
        bool,
        typer.Option('--check', help='Check a calibrated --model with known loads; write nothing.'),
    ] = False,
    bag: Annotated[
        OptionalPath,
        typer.Option(help='Recording of the procedure instead of a live sensor.', exists=True),
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
    """Calibrate the force of a sensor by weights or a kitchen scale; no force sensor needed."""
    start = find_model(model)
    content = read_model(start)
    card_sd = _checked(content, start, out, check=check, sideways=bool(sideways_loads))
    sd_g = load_sd if load_sd is not None else SCALE_SD_G if scale else LOAD_SD_G
    pulls = parse_pulls(sideways_loads, sd_g) if sideways_loads else []
    asked = parse_loads(loads or (CHECK_LOADS if check else DEFAULT_LOADS))
    known = [load_of(grams, sd_g) for grams in asked]
    if not check:
        check_loads(known)
    console = Console(markup=False)
    if bag is not None:
        session = from_bag(bag, content, known, '' if loads else reference, pulls)
    else:
        live = LiveProcedure(
            console, namespace, device, scale=scale, yes=yes, fewest=1 if check else 2
        )
        session = live.run(start, known, params_file, known=bool(loads), pulls=pulls)
    if scale and session.known_by == 'weights':
        session.known_by = 'scale'
    if check:
        _check(console, session, card_sd, {'model': str(start), 'device': device}, json)
        return
    assert out is not None  # noqa: S101  (checked above)
    calibration = fit_gain(session.loads, session.plateaus)
    sideways = fit_pulls(session.pulls) if session.pulls else None
    entry = card_entry(calibration, session, gel, start.name)
    _report(console, calibration)
    if sideways is not None:
        entry['sideways'] = sideways_entry(sideways, calibration.gain)
        _report_pulls(console, sideways, calibration.gain)
    # The weights first: the procedure took its time.
    save_calibrated(out, content, calibration, entry, sideways)
    console.print(f'wrote {out}; name it as `model` of fger in a parameter file')
    write_json(json, {'model': str(start), 'out': str(out), 'device': device} | entry)
    if figure is not None:
        draw(figure, session, calibration, entry)
        console.print(f'drawn: {figure}')


def parse_loads(text: str) -> list[float]:
    """Return the grams of a text like `20,50,100`.

    Raises:
        ForceCalibrationError: One is no number above 0.
    """
    try:
        grams = [float(part) for part in text.split(',')]
    except ValueError:
        grams = []
    if not grams or not all(0.0 < each < float('inf') for each in grams):
        raise ForceCalibrationError(
            f'loads {text!r} are not grams', 'units', 'give them like 20,50,100'
        )
    return grams


def _checked(content: Model, path: Path, out: Path | None, *, check: bool, sideways: bool) -> float:
    """Refuse what could only fail after the procedure; return the card's relative uncertainty."""
    from mixtac_fger.fger_net import checked_config

    if check and sideways:
        raise ForceCalibrationError(
            '--check and --sideways-loads do not go together',
            'pull',
            'check the normal force alone, or calibrate both again',
        )
    if sideways and not checked_config(content).shear:
        raise ModelError(
            f'{path} gives no sideways force', remedy='give no --sideways-loads, or another model'
        )
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
    checked_config(content)
    return 0.0


def card_entry(
    calibration: ForceCalibration, session: Session, gel: str, model: str
) -> dict[str, Any]:
    """Return what the model card and the JSON file say about a calibration.

    Args:
        calibration: The fit.
        session: Where it comes from.
        gel: Name of the gel.
        model: Name of the model that was calibrated.
    """
    c = calibration
    return {
        'date': dt.datetime.now(dt.timezone.utc).strftime('%Y-%m-%d'),
        'serial': session.serial,
        'gel': gel,
        'from': model,
        'known_by': session.known_by,
        'gain': round(c.gain, 5),
        'gain_sd': round(c.gain_sd, 5),
        'hysteresis_n': None if c.hysteresis_n is None else round(c.hysteresis_n, 4),
        'mae_before_n': round(c.mae_before_n, 4),
        'mae_after_n': round(c.mae_after_n, 4),
        'stopped_early': session.stopped_early,
        'loads': [
            {
                'load_g': round(point.load.grams, 2),
                'load_n': round(point.load.force_n, 4),
                'load_sd_n': round(point.load.sd_n, 4),
                'estimate_n': round(point.plateau.estimate_n, 4),
                'residual_n': round(point.residual_n, 4),
                'allowed_n': round(point.allowed_n, 4),
                'doubtful': point.doubtful,
                'sd_n': round(point.plateau.sd_n, 4),
                'creep_n_per_s': round(point.plateau.creep_n_per_s, 4),
                'zero_shift_n': round(point.plateau.zero_shift_n, 4),
                'unloading': point.plateau.unloading,
            }
            for point in c.points
        ],
    }


def sideways_entry(calibration: PullCalibration, normal_gain: float) -> dict[str, Any]:
    """Return what the model card and the JSON file say about the sideways force.

    Args:
        calibration: The fit.
        normal_gain: Gain of the normal force, which counts for the sideways force as well.
    """
    c = calibration
    gain, gain_sd = c.elsewhere(normal_gain)
    return {
        'gain': round(gain / normal_gain, 5),
        'gain_sd': round(gain_sd / normal_gain, 5),
        'pulled_gain': round(c.gain / normal_gain, 5),
        'pulled_gain_sd': round(c.gain_sd / normal_gain, 5),
        'turn_deg': None if c.turn is None else round(float(np.degrees(c.turn)), 1),
        'turn_sd_deg': None if c.turn is None else round(float(np.degrees(c.turn_sd)), 1),
        'mae_before_n': round(c.mae_before_n, 4),
        'mae_after_n': round(c.mae_after_n, 4),
        'loads': [
            {
                'load_g': round(pull.load.grams, 2),
                'load_n': round(pull.load.force_n, 4),
                'load_sd_n': round(pull.load.sd_n, 4),
                'way_deg': None if pull.way is None else round(float(np.angle(pull.way, deg=True))),
                'estimate_n': [round(pull.seen.real, 4), round(pull.seen.imag, 4)],
                'residual_n': round(residual, 4),
                'residual_across_n': round(across, 4),
                'allowed_n': round(allowed, 4),
                'left_n': round(pull.left_n, 4),
            }
            for pull, residual, across, allowed in c.points
        ],
    }


def save_calibrated(
    out: Path,
    model: Model,
    calibration: ForceCalibration,
    entry: dict[str, Any],
    sideways: PullCalibration | None = None,
) -> None:
    """Write a weight file that contains the gains, and its card.

    Args:
        out: Weight file.
        model: Model that was calibrated.
        calibration: The fit.
        entry: Its entry in the card.
        sideways: That of the sideways force; None to leave it at the gain of the normal force.

    Raises:
        FileError: It cannot be written.
    """
    from mixtac_fger.fger_net import CALIBRATED_DEVIATION, with_gain, with_sideways_gain
    from mixtac_fger.weights import save_model

    before = model.card.training
    training = before | {CALIBRATED_KEY: entry}
    if entry['serial']:
        training[SERIAL_KEY] = entry['serial']
    # Deviations become those of a known gain once.
    known = not {CALIBRATED_KEY, ADAPTED_KEY}.isdisjoint(before)
    scaled = with_gain(model, calibration.gain, 1.0 if known else CALIBRATED_DEVIATION)
    if sideways is not None:
        gain, _ = sideways.elsewhere(calibration.gain)
        scaled = with_sideways_gain(scaled, gain / calibration.gain)
    card = ModelCard(training, model.card.metrics)
    save_model(out, Model(scaled.architecture, scaled.version, scaled.config, card, scaled.tensors))


def _report(console: Console, calibration: ForceCalibration) -> None:
    c = calibration
    names = ('load [g]', 'known', 'estimate', 'calibrated', 'residual', 'creep', 'zero shift')
    rows = [
        (
            f'{load.grams:.1f}' + (' down' if plateau.unloading else ''),
            f'{load.force_n:.3f}',
            f'{plateau.estimate_n:.3f}',
            f'{c.gain * plateau.estimate_n:.3f}',
            f'{residual:+.3f}',
            f'{plateau.creep_n_per_s:+.4f}',
            f'{plateau.zero_shift_n:+.3f}',
        )
        for load, plateau, residual, _ in c.points
    ]
    console.print(make_table('Known loads; forces in N, creep in N/s', names, rows))
    for point in c.points:
        if point.doubtful:
            console.print(
                f'warning: {point.load.grams:.1f} g fit the other loads badly; check these grams,'
                ' or put them on again'
            )
    hysteresis = '' if c.hysteresis_n is None else f'; hysteresis {c.hysteresis_n:+.3f} N'
    console.print(
        f'gain {c.gain:.3f} +- {c.gain_sd:.3f} (one standard deviation){hysteresis}; mean error at'
        f' the loads {c.mae_before_n:.3f} N before, {c.mae_after_n:.3f} N after',
        highlight=False,
    )


def _report_pulls(console: Console, calibration: PullCalibration, normal_gain: float) -> None:
    c = calibration
    names = ('pull [g]', 'known', 'estimate x', 'y', 'residual', 'across', 'left behind')
    rows = []
    for pull, residual, across, _ in c.points:
        parts = (pull.seen.real, pull.seen.imag, residual, across)
        cells = (f'{pull.load.grams:.1f}', f'{pull.load.force_n:.3f}')
        rows.append((*cells, *(f'{part:+.3f}' for part in parts), f'{pull.left_n:.3f}'))
    console.print(make_table('Known pulls; forces in N', names, rows))
    console.print(
        f'sideways: known pulls are {c.gain:.3f} +- {c.gain_sd:.3f} times the estimates; mean error'
        f' at the pulls {c.mae_before_n:.3f} N before, {c.mae_after_n:.3f} N after',
        highlight=False,
    )
    gain, gain_sd = c.elsewhere(normal_gain)
    console.print(
        f'gain of the weight file {gain:.3f} +- {gain_sd:.3f}: what these pulls let expect at other'
        f' places and forces, where that of the normal force is {normal_gain:.3f}',
        highlight=False,
    )
    if c.turn is not None and abs(c.turn) > DOUBT * c.turn_sd:
        console.print(
            f'warning: the pulls are seen {-np.degrees(c.turn):+.0f} +- {np.degrees(c.turn_sd):.0f}'
            ' degrees from their directions, from x to y; pull along the edges of the image, or'
            ' correct how the sensor is mounted in the robot description'
        )


def _check(
    console: Console,
    session: Session,
    relative_sd: float,
    facts: dict[str, Any],
    json: Path | None,
) -> None:
    """Print whether a calibrated sensor still reads known loads.

    Raises:
        ForceCalibrationError: It does not.
    """
    found = []
    for load, plateau in zip(session.loads, session.plateaus, strict=True):
        each = check_gain(load, plateau, relative_sd)
        found.append(each)
        console.print(
            f'{load.grams:.1f} g: known {load.force_n:.3f} N, estimated {plateau.estimate_n:.3f} N;'
            f' ratio {each.ratio:.3f} +- {each.ratio_sd:.3f}, {1.0 - each.allowed:.2f} to'
            f' {1.0 + each.allowed:.2f} pass: {"pass" if each.passed else "FAIL"}',
            highlight=False,
        )
    passed = all(each.passed for each in found)
    if json is not None:
        checks = [each._asdict() for each in found]
        write_json(json, facts | {'serial': session.serial, 'passed': passed, 'checks': checks})
    if not passed:
        raise ForceCalibrationError('the sensor no longer reads the known loads', 'changed')


def draw(
    path: Path, session: Session, calibration: ForceCalibration, entry: dict[str, Any]
) -> None:
    """Draw the series with its plateaus, and the fit.

    Args:
        path: File to write; its suffix gives the format.
        session: Series and plateaus.
        calibration: The fit.
        entry: Its entry in the card.

    Raises:
        FileError: The picture cannot be written.
    """
    c = calibration
    title = f'{entry["serial"] or "sensor"}: gain {c.gain:.3f} +- {c.gain_sd:.3f}, {entry["date"]}'
    figure = new_figure(12, 4.5, title)
    series, fit = figure.subplots(1, 2, width_ratios=(2, 1))
    series.plot(session.t_s, session.force_n, color=FORCE, alpha=0.4, lw=0.6, label='estimate')
    series.plot(session.t_s, c.gain * session.force_n, color=FORCE, lw=0.8, label='calibrated')
    force = np.array([point.load.force_n for point in c.points])
    plateaus = [point.plateau for point in c.points]
    starts, ends = [each.start_s for each in plateaus], [each.end_s for each in plateaus]
    series.hlines(force, starts, ends, color=KNOWN, lw=2, label='known load')
    series.set(xlabel='time [s]', ylabel='normal force [N]')
    series.legend(loc='upper left', frameon=False)
    seen = np.array([each.estimate_n for each in plateaus])
    line = np.array([0.0, 1.1 * seen.max()])
    fit.plot(line, c.gain * line, color=FORCE)
    fit.fill_between(
        line, (c.gain - c.gain_sd) * line, (c.gain + c.gain_sd) * line, color=FORCE, alpha=0.2
    )
    load_sd = [point.load.sd_n for point in c.points]
    fit.errorbar(seen, force, yerr=load_sd, fmt='o', color=KNOWN)
    down = np.array([each.unloading for each in plateaus])
    if down.any():
        fit.plot(seen[down], force[down], 'v', color=MARK, label='unloading')
        fit.legend(frameon=False)
    fit.set(xlabel='estimate [N]', ylabel='known load [N]')
    save_figure(figure, path)
