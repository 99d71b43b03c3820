# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac doctor --acceptance`: guides a person through the checks, and writes the report."""

from __future__ import annotations

import datetime as dt
import platform
import sys
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

import typer
from rich.console import Console
from rich.markup import escape

from mixtac_cli.bundle import hashed
from mixtac_driver.doctor.acceptance import SETTLE_S, Person, accept
from mixtac_driver.doctor.stretch import CHECKS, Outcome
from mixtac_driver.parameters import DriverParameters

LEAST_S = 12.0
"""Shortest still stretch of the command [s]: a skew takes ten."""
COLOURS = {Outcome.PASS: 'green', Outcome.FAIL: 'bold red', Outcome.SKIP: 'yellow'}
VIRTUAL_EDGES_HZ = 20.0
VIRTUAL_FLASHES = 8
OUTAGE_S = 0.5
VIRTUAL_SETTLE_S = 5.0
"""A virtual sensor compiles when it first streams, and stops its time meanwhile."""


def person(console: Console, *, flash: bool, unplug: bool, edges_hz: float) -> Person:
    """Return somebody who is asked on the console, or who knows from the options what comes.

    Args:
        console: Where to ask.
        flash: A light is flashed without a question.
        unplug: The camera is unplugged without a question.
        edges_hz: Frequency at the synchronisation connector [Hz], 0 for none.
    """
    asking = sys.stdin.isatty()

    def ask_flash(seconds: float) -> None:
        console.print(f'flash a torch at the sensor, five times or more within {seconds:.0f} s')
        if asking:
            typer.prompt('press Enter and begin', default='', show_default=False)

    def ask_unplug() -> None:
        console.print('unplug the camera, wait a second, and plug it in again')

    return Person(
        flash=ask_flash if flash or asking else None,
        unplug=ask_unplug if unplug or asking else None,
        edges_hz=edges_hz,
    )


def automatic(backend: Any) -> Person:  # noqa: ANN401
    """Return the one who does it to the virtual camera.

    Args:
        backend: A pyusb backend of the virtual camera.
    """
    from mixtac_sim.usb.faults import Fault, FaultKind

    def flash(seconds: float) -> None:
        # The phase to the frames differs from flash to flash.
        step_s = 0.9 * seconds / VIRTUAL_FLASHES
        for k in range(VIRTUAL_FLASHES):
            start_s = 0.2 + k * (round(step_s / 0.04) * 0.04 + 0.0247)
            backend.inject(Fault(FaultKind.FLASH, seconds=0.1 + 0.0092 * k, delay=start_s))

    def unplug() -> None:
        backend.inject(Fault(FaultKind.UNPLUG, seconds=OUTAGE_S))

    backend.inject(Fault(FaultKind.EDGES, amount=VIRTUAL_EDGES_HZ))
    return Person(flash, unplug, VIRTUAL_EDGES_HZ)


def check_camera(
    console: Console,
    parameters: DriverParameters,
    seconds: float,
    who: Person,
    backend: Any,  # noqa: ANN401
) -> dict[str, Any]:
    """Make the checks, print each, and return the report for JSON.

    Args:
        console: Where to print.
        parameters: Device and serial number.
        seconds: Length of the still stretch [s].
        who: Does what cannot be done over USB.
        backend: A pyusb backend, or None for the one that the device string names.
    """
    console.print('the sensor must rest untouched, in steady light', soft_wrap=True)
    identity: dict[str, str] = {}
    checks = []
    settle_s = SETTLE_S if backend is None else VIRTUAL_SETTLE_S
    options: dict[str, Any] = {'backend': backend, 'identify': identity.update}
    for check in accept(parameters, seconds, who, settle_s=settle_s, **options):
        checks.append(check)
        colour = COLOURS[check.outcome]
        limit = f' [dim](limit {escape(check.limit)})[/dim]' if check.limit else ''
        console.print(
            f'{check.number:2d} {check.name}: [{colour}]{check.outcome.value}[/{colour}] '
            f'{escape(check.found)}{limit}',
            soft_wrap=True,
        )
    return {
        'device': parameters.device,
        'camera': {**identity, 'serial': hashed(identity.get('serial', ''))},
        'computer': f'{platform.system()} {platform.release()} {platform.machine()}',
        'version': version('mixtac_driver'),
        'date': dt.datetime.now(dt.timezone.utc).date().isoformat(),
        'checks': [
            {'name': check.name, **asdict(check), 'outcome': check.outcome.value}
            for check in sorted(checks, key=lambda each: each.number)
        ],
    }


def row(report: dict[str, Any]) -> str:
    """Return the row of the table of reports in docs/hardware_reports.md.

    Args:
        report: What `check_camera` returned.
    """
    camera = report['camera']
    kind = 'virtual' if report['device'].startswith('virtual') else camera.get('chip', 'unknown')
    cells = [
        report['date'],
        f'{kind} {camera["serial"]}, firmware {camera.get("firmware", "?")}',
        report['computer'],
        report['version'],
    ]
    known = {check['number']: check for check in report['checks']}
    for number in range(1, len(CHECKS) + 1):
        check = known.get(number, {'outcome': 'skip', 'figure': None})
        figure = '' if check['figure'] is None else f' {check["figure"]:.3g}'
        cells.append(check['outcome'] + figure)
    return f'| {" | ".join(cells)} |'


def failures(report: dict[str, Any]) -> int:
    """Return how many checks failed."""
    return sum(check['outcome'] == Outcome.FAIL.value for check in report['checks'])


def header() -> str:
    """Return the first two lines of the table of reports."""
    names = [f'{k} {name}' for k, name in enumerate(CHECKS, 1)]
    cells = ['date', 'camera', 'computer', 'version', *names]
    return f'| {" | ".join(cells)} |\n|{"---|" * len(cells)}'
