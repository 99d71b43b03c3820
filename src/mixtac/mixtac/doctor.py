# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac doctor`: check software, camera and computer, and say how to fix what is wrong."""

from __future__ import annotations

import importlib
import json as json_format
import math
import os
import sys
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from importlib.metadata import distributions
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from mixtac.options import JsonFile, OptionalPath
from mixtac_core.events.errors import MixtacError
from mixtac_core.node.files import replacing, writable, write_json
from mixtac_core.node.parameters import parameter_file
from mixtac_driver.device import check_device, is_real
from mixtac_driver.doctor import (
    Finding,
    Level,
    RawData,
    check_attached,
    check_clock,
    check_disk,
    check_running,
    first_to_do,
    ok,
    worst,
)
from mixtac_driver.parameters import DriverParameters

STYLES = {Level.OK: 'green', Level.WARN: 'yellow', Level.ERROR: 'bold red'}


def doctor(
    device: Annotated[str, typer.Option(help='davis346, virtual, or virtual:SOCKET.')] = 'davis346',
    serial: Annotated[
        str, typer.Option(help='Serial number of the camera, if several are attached.')
    ] = '',
    seconds: Annotated[
        float, typer.Option(min=0.5, max=600, help='Duration of the measurement of the camera (s).')
    ] = 3.0,
    json: JsonFile = None,
    bundle: Annotated[
        OptionalPath,
        typer.Option(
            metavar='FILE.zip',
            callback=writable,
            help='Zip file to write for a bug report: findings, versions, parameters, raw data.',
        ),
    ] = None,
) -> None:
    """Check software, camera and computer, measure the camera, and suggest fixes."""
    console, raw = Console(), RawData() if bundle is not None else None
    p = DriverParameters(device=device, serial=serial)
    findings: list[Finding] = []
    for section, found in examine(p, seconds, raw=raw):
        findings += found
        console.print(table(section, found))
    level, first, verdict = worst(findings), first_to_do(findings), 'no problems found'
    if first is not None:
        verdict = f'fix first: {first.name}: {first.remedy or first.found}'
    console.print(f'[{STYLES[level]}]{escape(verdict)}', soft_wrap=True)
    report: dict[str, Any] = {'device': device, 'level': level.name.lower(), 'verdict': verdict}
    report['findings'] = [_row(each) for each in findings]
    write_json(json, report)
    if bundle is not None and raw is not None:
        write_bundle(bundle, report, p, raw)
        console.print(f'written to {escape(str(bundle))}', soft_wrap=True)
    if level is Level.ERROR:
        raise typer.Exit(1)


def write_bundle(path: Path, report: dict[str, Any], p: DriverParameters, raw: RawData) -> None:
    """Write a zip file for a bug report.

    It holds `findings.json`, `versions.json`, `driver.yaml` with the settings of the camera,
    `registers.json` with its registers, and `words.bin` with the bytes that it sent.

    Raises:
        FileError: The file cannot be written.
    """
    packages = {each.name: each.version for each in distributions() if each.name}
    texts = {
        'findings.json': json_format.dumps(report, indent=2),
        'versions.json': json_format.dumps({'python': sys.version, **packages}, indent=2),
        'registers.json': json_format.dumps(raw.registers, indent=2),
        'driver.yaml': parameter_file('driver', p),
    }
    home = str(Path.home())
    with (
        replacing(path) as scratch,
        zipfile.ZipFile(scratch, 'w', zipfile.ZIP_DEFLATED) as archive,
    ):
        for name, text in texts.items():
            archive.writestr(name, text if home == '/' else text.replace(home, '~'))
        archive.writestr('words.bin', bytes(raw.words))


def _row(finding: Finding) -> dict[str, object]:
    """Return a finding for JSON, which has no NaN."""
    values = {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in finding.values.items()
    }
    return asdict(finding) | {'level': finding.level.name.lower(), 'values': values}


def examine(
    p: DriverParameters, seconds: float, *, root: Path = Path('/'), raw: RawData | None = None
) -> Iterator[tuple[str, list[Finding]]]:
    """Check everything; yield each section when it is done.

    Args:
        p: Device (`davis346`, `virtual` or `virtual:PATH`) and serial number.
        seconds: How long to measure the camera [s].
        root: Folder used as the root of the file system.
        raw: Receives what the camera sent.

    Raises:
        UnknownDeviceError: The device string is unknown.
    """
    check_device(p.device)

    yield 'software', [check_ros(os.environ), check_model()]
    if is_real(p.device):
        attached = check_attached(p.serial, root)
        yield 'camera', attached
        if worst(attached) < Level.ERROR:
            yield 'measured', list(check_running(p, seconds, raw))
    else:
        with virtual_camera(p.device) as (backend, finding):
            yield 'camera', [finding]
            if backend is not None:
                yield 'measured', list(check_running(p, seconds, raw, backend))
    yield 'computer', [check_disk(Path.cwd()), check_clock()]


def table(section: str, findings: list[Finding]) -> Table:
    """Return the findings of a section as a table."""
    columns = ('name', 'level', Column(overflow='fold'))
    result = Table(*columns, title=section, title_justify='left', show_header=False)
    for finding in findings:
        style = STYLES[finding.level]
        text = escape(finding.found)
        if finding.remedy:
            text += f'\n[bold]-> {escape(finding.remedy)}[/bold]'
        result.add_row(finding.name, f'[{style}]{finding.level.name.lower()}[/{style}]', text)
    return result


def check_ros(environment: Mapping[str, str]) -> Finding:
    """Check that rclpy can be imported, and report distribution, middleware and domain.

    Args:
        environment: Variables of the process.
    """
    try:
        utilities = importlib.import_module('rclpy.utilities')
    except ImportError as error:
        remedy = 'source ROS 2, or run this from a checkout as ./mixtac, which brings it'
        return Finding('ROS 2', Level.WARN, f'rclpy cannot be imported: {error}', remedy)
    named = environment.get('ROS_DISTRO', 'wheels')
    rmw = utilities.get_rmw_implementation_identifier()
    domain = environment.get('ROS_DOMAIN_ID') or '0'
    reach = environment.get('ROS_AUTOMATIC_DISCOVERY_RANGE') or 'not restricted'
    found = f'{named}, {rmw}, domain {domain}, discovery range {reach}'
    return ok('ROS 2', found, distribution=named, rmw=rmw, domain=domain, range=reach)


def check_model() -> Finding:
    """Check whether the shipped model of the estimator can be loaded."""
    from mixtac_fger.estimator import open_estimator
    from mixtac_fger.weights import DEFAULT_MODEL, find_model, read_model

    path = find_model(DEFAULT_MODEL)
    try:
        open_estimator(read_model(path))
    except MixtacError as error:
        return Finding('model', Level.ERROR, error.message, error.remedy)
    return ok('model', str(path))


@contextmanager
def virtual_camera(device: str) -> Iterator[tuple[Any, Finding]]:
    """Find the virtual sensor of a device string, or start one in this process.

    Args:
        device: `virtual`, or `virtual:PATH` for the sensor that listens on that socket.

    Yields:
        A pyusb backend, None if the named sensor does not answer, and the finding.
    """
    from mixtac_driver.device import open_backend
    from mixtac_sim import SimulationError

    name, found = 'virtual sensor', 'a running one is checked'
    with ExitStack() as closing:
        try:
            backend = open_backend(device)
        except SimulationError as error:
            if device != 'virtual':
                yield None, Finding(name, Level.ERROR, error.message, error.remedy)
                return
            from mixtac_sim.live.virtual_sensor import make_virtual_sensor
            from mixtac_sim.usb.pyusb_backend import in_process_backend

            sensor = make_virtual_sensor(device_seed=1001, seed=1001)
            sensor.start()
            closing.callback(sensor.close)
            backend = in_process_backend(sensor.device)
            found = 'none is running; one was started for this check'
        yield backend, ok(name, found)
