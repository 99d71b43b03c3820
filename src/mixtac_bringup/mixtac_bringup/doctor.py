# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac doctor`: is all there, does the camera work, and what to do about what does not."""

from __future__ import annotations

import json as json_format
import math
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from mixtac_driver.backend import check_device, is_real
from mixtac_driver.doctor.finding import Level, first_to_do, worst

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mixtac_driver.doctor.finding import Finding
    from mixtac_driver.doctor.host_files import HostFiles

STYLES = {Level.OK: 'green', Level.WARN: 'yellow', Level.ERROR: 'bold red'}
DEFAULT_SECONDS = 3.0
OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)


@dataclass
class Report:
    """All findings, by section.

    Attributes:
        device: Device string.
        sections: Name of the section and its findings.
    """

    device: str
    sections: list[tuple[str, list[Finding]]] = field(default_factory=list)

    @property
    def findings(self) -> list[Finding]:
        """All findings in order."""
        return [finding for _, findings in self.sections for finding in findings]

    @property
    def verdict(self) -> str:
        """What to do first, in one line."""
        first = first_to_do(self.findings)
        if first is None:
            return 'all is well'
        return f'first: {first.name}: {first.remedy or first.found}'

    def as_json(self) -> str:
        """Return the report as JSON."""
        found = [
            {
                'section': section,
                'name': f.name,
                'level': f.level.name.lower(),
                'found': f.found,
                'remedy': f.remedy,
                'values': {key: _finite(value) for key, value in f.values.items()},
            }
            for section, findings in self.sections
            for f in findings
        ]
        level = worst(self.findings).name.lower()
        content = {
            'device': self.device,
            'level': level,
            'verdict': self.verdict,
            'findings': found,
        }
        return json_format.dumps(content, indent=2, allow_nan=False) + '\n'


def _finite(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def doctor(
    device: Annotated[
        str, typer.Option(help='davis346, virtual, or virtual:PATH of its socket.')
    ] = 'davis346',
    serial: Annotated[str, typer.Option(help='Serial number, if several are attached.')] = '',
    seconds: Annotated[
        float, typer.Option(min=0.5, max=600, help='How long to measure the camera.')
    ] = DEFAULT_SECONDS,
    json: Annotated[OptionalPath, typer.Option(help='Write the findings there as well.')] = None,
) -> None:
    """Check software, camera and computer, measure the camera, say what to do about problems."""
    console, report = Console(), Report(device)
    for section in examine(device, seconds, serial=serial):
        report.sections.append(section)
        console.print(table(*section))
    console.print(f'[{STYLES[worst(report.findings)]}]{escape(report.verdict)}', soft_wrap=True)
    if json is not None:
        json.parent.mkdir(parents=True, exist_ok=True)
        json.write_text(report.as_json())
    if worst(report.findings) is Level.ERROR:
        raise typer.Exit(1)


def examine(
    device: str, seconds: float, *, serial: str = '', root: Path = Path('/')
) -> Iterator[tuple[str, list[Finding]]]:
    """Look at everything; sections come as they are done, those that others need first.

    Args:
        device: `davis346`, `virtual` or `virtual:PATH`.
        seconds: How long to measure the camera [s].
        serial: Serial number of the camera, or empty for the only one.
        root: What stands for the root folder.

    Raises:
        UnknownDeviceError: Nothing is known by that device string.
    """
    # Only this command needs the camera's and the simulation's compiled code.
    from mixtac_bringup import doctor_checks
    from mixtac_driver.doctor.computer import check_computer
    from mixtac_driver.doctor.host_files import HostFiles

    check_device(device)
    files = HostFiles(root)
    software = [*doctor_checks.check_ros(os.environ), doctor_checks.check_model()]
    if is_real(device):
        yield 'software', [*software, doctor_checks.check_virtual_sensor()]
        yield from _real_camera(device, seconds, serial, files)
    else:
        yield 'software', software
        yield from _virtual_camera(device, seconds, serial)
    yield 'computer', check_computer(files, Path.cwd())


def _real_camera(
    device: str, seconds: float, serial: str, files: HostFiles
) -> Iterator[tuple[str, list[Finding]]]:
    from mixtac_driver.doctor.camera_checks import check_attached
    from mixtac_driver.doctor.running_camera import check_running

    attached = check_attached(files, serial)
    yield 'camera', attached
    if worst(attached) < Level.ERROR:
        yield 'measured', list(check_running(device, seconds, serial=serial))


def _virtual_camera(
    device: str, seconds: float, serial: str
) -> Iterator[tuple[str, list[Finding]]]:
    from mixtac_bringup.doctor_checks import virtual_camera
    from mixtac_driver.doctor.running_camera import check_running

    with virtual_camera(device) as (backend, finding):
        yield 'camera', [finding]
        if backend is not None:
            found = check_running(device, seconds, serial=serial, backend=backend)
            yield 'measured', list(found)


def table(section: str, findings: list[Finding]) -> Table:
    """Return the findings of a section as a table."""
    result = Table(title=section, title_justify='left', title_style='bold', show_header=False)
    result.add_column('name', no_wrap=True)
    result.add_column('level', no_wrap=True)
    result.add_column('found', overflow='fold')
    for finding in findings:
        style = STYLES[finding.level]
        text = escape(finding.found)
        if finding.remedy:
            text += f'\n[bold]-> {escape(finding.remedy)}[/bold]'
        result.add_row(finding.name, f'[{style}]{finding.level.name.lower()}[/{style}]', text)
    return result
