# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac up slip`: slip control on a simulated grasp and arm, over real DDS, until interrupted.

Slip control, arm and supervisor take their time from the simulation (`/clock`): a host that is late
slows down everything alike, and neither watchdogs nor the answer to a blow depend on its speed.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated

import typer

from mixtac_bringup.graph import config_file, executable, yaml_value

NAMESPACE = 'mixtac'
ENDED_FIRST = ('supervisor', 'slip_control', 'driver')
"""So that no node loses another that it needs."""


def slip(
    object_name: Annotated[str, typer.Option('--object', help='box, cup or ball.')] = 'box',
    disturb: Annotated[
        float, typer.Option('--disturb', help='Speed of each blow (mm/s); 0 for none.')
    ] = 50.0,
    every: Annotated[float, typer.Option(help='Time between blows (s).')] = 8.0,
    margin: Annotated[float, typer.Option(help='Grasp force over the least that holds.')] = 1.05,
    preset: Annotated[str, typer.Option(help='How hard the sensor is.')] = 'paper_like',
    seed: Annotated[int, typer.Option(help='Which sensor, day and object.')] = 1,
    plant: Annotated[
        str, typer.Option(help='What the arm is: lag, or mujoco (requirements/mujoco.txt).')
    ] = 'lag',
    seconds: Annotated[float, typer.Option(help='How long; 0 until interrupted (s).')] = 0.0,
) -> None:
    """Hold a simulated object against blows with the real driver and slip control."""
    from mixtac_bringup.processes import ProcessGroup

    with tempfile.TemporaryDirectory(prefix='mixtac-') as folder, ProcessGroup() as processes:
        socket = str(Path(folder) / 'usb.sock')
        grasp = {
            'object': object_name,
            'knock': disturb,
            'margin': margin,
            'preset': preset,
            'device_seed': seed,
            'seed': seed,
            'socket': socket,
            'publish_clock': True,
        }
        processes.start('virtual_grasp', _simulated('virtual_grasp', **grasp))
        processes.start('virtual_arm', _simulated('virtual_arm', plant=plant, use_sim_time=True))
        processes.start('driver', _installed('driver', 'mixtac_driver', device=f'virtual:{socket}'))
        control = {
            'arm': 'fr3',
            'normal_frame': 'base',
            'normal_y': 1.0,
            'normal_z': 0.0,
            'use_sim_time': True,
        }
        processes.start(
            'slip_control', _installed('slip_control', 'mixtac_slip_control', **control)
        )
        processes.start('supervisor', _supervisor(every if disturb > 0.0 else 0.0))
        end = time.monotonic() + seconds
        try:
            while not seconds or time.monotonic() < end:
                time.sleep(0.2)
                processes.check()
        finally:
            for name in ENDED_FIRST:
                processes.stop(name)


def _simulated(name: str, **values: object) -> list[str]:
    return _command([str(executable('mixtac_sim', f'{name}_node'))], name, values)


def _installed(name: str, package: str, **values: object) -> list[str]:
    return _command([str(executable(package, f'{name}_node'))], name, values)


def _supervisor(every: float) -> list[str]:
    return [
        *(sys.executable, '-m', f'{__package__}.supervisor_node', '--ros-args'),
        *('-r', f'__ns:=/{NAMESPACE}', '-p', f'knock_every:={yaml_value(every)}'),
        *('-p', 'use_sim_time:=true'),
    ]


def _command(program: list[str], name: str, values: dict[str, object]) -> list[str]:
    given = [part for key, v in values.items() for part in ('-p', f'{key}:={yaml_value(v)}')]
    shipped = str(config_file(f'{name}.yaml'))
    arguments = ['--ros-args', '-r', f'__ns:=/{NAMESPACE}', '--params-file', shipped]
    return [*program, *arguments, *given]
