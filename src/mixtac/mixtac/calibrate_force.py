# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac calibrate-force`: options, result and weight file."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console

from mixtac.figures import make_table
from mixtac.loads import LiveProcedure, Session, from_bag
from mixtac.options import JsonFile, Namespace, OptionalPath, ParamsFile, ReferenceTopic
from mixtac.up import start_nodes
from mixtac_core.node.files import write_json
from mixtac_core.node.graph import NodeSpec, is_virtual, sensor_graph
from mixtac_core.node.process import ProcessGroup
from mixtac_core.node.topics import DEFAULT_NAMESPACE, REFERENCE
from mixtac_fger.config import ModelError
from mixtac_fger.estimator import CALIBRATED_KEY, SERIAL_KEY
from mixtac_fger.fger_net import checked_config, with_gain
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
from mixtac_fger.streaming import STALE_FRAME_US
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
            help='Loads (g) on a string, such as 20, that pull the largest other load sideways, '
            'for the sideways force. In a recording, they are in the last contact.'
        ),
    ] = '',
    scale: Annotated[
        bool,
        typer.Option('--scale', help='Without weights: press until a kitchen scale shows a load.'),
    ] = False,
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
    namespace: Namespace = DEFAULT_NAMESPACE,
    params_file: ParamsFile = None,
) -> None:
    """Calibrate the force of a sensor with weights or a kitchen scale, without a force sensor."""
    start = find_model(model)
    content = read_model(start)
    check_model(content, start, out, check=check, sideways=bool(sideways_loads))
    sd_g = SCALE_SD_G if scale else LOAD_SD_G
    known = parse_loads(loads or (CHECK_LOADS if check else DEFAULT_LOADS), sd_g)
    pulls = parse_loads(sideways_loads, sd_g) if sideways_loads else []
    if not check:
        check_loads(known)
    console = Console(markup=False, highlight=False)
    # Loads that are named are used even where a reference sensor measures them.
    if bag is not None:
        session = from_bag(bag, content, known, pulls, '' if loads else reference)
    else:
        from mixtac.monitor_node import Monitor

        prompt = 'Press until the scale shows {:g} g' if scale else 'Put {:g} g on'
        console.print('starting the sensor; a first start compiles for a minute')
        with ProcessGroup() as processes, Monitor(namespace, processes, SESSION_S) as monitor:
            start_nodes(processes, measured_sensor(device, start), namespace, params_file, 'warn')
            monitor.listen(reference)
            monitor.wait(lambda: monitor.estimate.received > 0, 'the first force')
            drives = yes and is_virtual(device)
            procedure = LiveProcedure(console, monitor, yes=yes, drives=drives)
            session = procedure.lead(known, pulls, prompt)
            if not loads and monitor.measured.received > 0:
                session.measure(*procedure.reference())
    facts = {'model': str(start), 'device': device, 'serial': session.serial}
    if check:
        write_json(json, facts | check_gain(console, session, content))
        return
    assert out is not None  # noqa: S101  (checked above)
    check_loads(session.loads)
    entry = {
        'date': dt.datetime.now(dt.timezone.utc).strftime('%Y-%m-%d'),
        'serial': session.serial,
        'gel': gel,
        'from': start.name,
        'known_by': 'reference' if session.by_reference else 'scale' if scale else 'weights',
    }
    calibrated = calibrate(console, content, session, entry)
    # The weights first: the procedure took its time.
    save_model(out, calibrated)
    console.print(f'wrote {out}; name it as `model` of fger in a parameter file')
    write_json(json, facts | {'out': str(out)} | entry)


def measured_sensor(device: str, model: Path) -> list[NodeSpec]:
    """Return the nodes of a sensor whose model is measured, whatever a parameter file sets.

    The prompts ask for an untouched sensor. Forces that are not valid count, as in a recording:
    loads reveal wrong ones. Those without a recent frame do not: events alone drift.

    Args:
        device: As for `mixtac up`.
        model: Weight file of the estimator.
    """
    estimator: dict[str, object] = {'model': str(model.resolve()), 'assume_free': True}
    estimator |= {'force_scale': 1.0, 'sideways_scale': 1.0, 'tare_on_release': False}
    estimator |= {'invalid_force': 'publish', 'longest_without_frame': 1e-6 * STALE_FRAME_US}
    return sensor_graph(device, estimator=estimator)


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


def check_model(
    content: Model, path: Path, out: Path | None, *, check: bool, sideways: bool
) -> None:
    """Reject a model or a name of the result that do not suit, before the procedure.

    Raises:
        ModelError: They do not.
    """
    config = checked_config(content)
    if sideways and (check or not config.shear):
        why = 'is checked by its normal force alone' if check else 'gives no sideways force'
        raise ModelError(f'{path} {why}', remedy='give no --sideways-loads')
    if check and not isinstance(content.card.training.get(CALIBRATED_KEY), dict):
        raise ModelError(
            f'{path} was not calibrated, so there is nothing to check',
            remedy='give the weight file that calibrate-force wrote as --model',
        )
    if not check and (out is None or out.suffix != SUFFIX):
        raise ModelError(
            f'{out} is not a weight file to write' if out else '--out is missing',
            remedy=f'give --out a name that ends in {SUFFIX}',
        )


def calibrate(console: Console, content: Model, session: Session, entry: dict[str, Any]) -> Model:
    """Fit the gains, print them, and return the calibrated model.

    Args:
        console: Where to print.
        content: Model that estimated the forces.
        session: Loads and plateaus.
        entry: Entry of the model card, completed here.

    Raises:
        ForceCalibrationError: The loads disagree, or no gel explains them.
    """
    normal = fit_gain(session.loads, session.plateaus)
    entry |= _entry(normal)
    entry |= {'share': round(normal.share, 5), 'exponent': round(normal.exponent, 5)}
    _report(console, 'Known loads', entry)
    console.print(
        f'forces elsewhere and later +- {normal.share:.0%} (one standard deviation);'
        f' the loads grow as the estimate to the power {normal.exponent:.2f}'
    )
    sideways = 1.0
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
        sideways = gain / normal.gain
    scaled = with_gain(content, normal.gain, sideways, normal.share)
    training = content.card.training | {CALIBRATED_KEY: entry}
    if session.serial:
        training[SERIAL_KEY] = session.serial
    return replace(scaled, card=ModelCard(training, content.card.metrics))


COLUMNS = ('load_g', 'load_n', 'estimate_n', 'residual_n', 'allowed_n')
"""Columns of the table of loads; `allowed_n` is the largest residual that can be explained."""


def _entry(calibration: ForceCalibration) -> dict[str, Any]:
    """Return the fields of a fit for the model card and the JSON file."""
    rows = [
        (load.grams, load.force_n, plateau.size_n, residual, allowed)
        for load, plateau, residual, allowed in calibration.points
    ]
    return {
        'gain': round(calibration.gain, 5),
        'gain_sd': round(calibration.gain_sd, 5),
        'loads': [dict(zip(COLUMNS, np.round(row, 4).tolist(), strict=True)) for row in rows],
    }


def _report(console: Console, title: str, entry: dict[str, Any]) -> None:
    rows = [[f'{value:.3f}' for value in load.values()] for load in entry['loads']]
    console.print(make_table(f'{title}; forces in N', COLUMNS, rows))
    console.print(f'gain {entry["gain"]:.3f} +- {entry["gain_sd"]:.3f} (one standard deviation)')


def check_gain(console: Console, session: Session, content: Model) -> dict[str, Any]:
    """Print and return the ratio of each known load to the force of a calibrated model.

    Raises:
        ForceCalibrationError: The sensor no longer reads a load.
    """
    card = content.card.training[CALIBRATED_KEY]
    relative_sd = float(card['gain_sd']) / float(card['gain'])
    checks = []
    for load, plateau in zip(session.loads, session.plateaus, strict=True):
        fit = fit_gain([load], [plateau])
        allowed = 2.0 * float(np.hypot(fit.gain_sd, relative_sd))
        text = (
            f'{load.grams:.1f} g: known {load.force_n:.3f} N, estimated {plateau.size_n:.3f} N;'
            f' ratio {fit.gain:.3f}, {1.0 - allowed:.2f} to {1.0 + allowed:.2f} pass'
        )
        if abs(fit.gain - 1.0) > allowed:
            raise ForceCalibrationError(
                text, 'loads', 'look at gel, lamp and mount, then calibrate it again'
            )
        console.print(text)
        checks.append({'ratio': fit.gain, 'ratio_sd': fit.gain_sd, 'allowed': allowed})
    return {'passed': True, 'checks': checks}
