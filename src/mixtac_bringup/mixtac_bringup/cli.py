# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The `mixtac` command line."""

from __future__ import annotations

import datetime as dt
import sys
from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console
from rich.table import Table

from mixtac_bringup import bench
from mixtac_events.errors import MixtacError

app = typer.Typer(
    name='mixtac',
    help='Mixtac: a tactile fingertip of events and frames, in ROS 2.',
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

app.add_typer(bench.app)
experiments = typer.Typer(
    name='experiments', help='Experiments on the virtual sensor.', no_args_is_help=True
)
app.add_typer(experiments)
up_commands = typer.Typer(name='up', invoke_without_command=True)
app.add_typer(up_commands)

INTERRUPTED = 130
OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)


@app.command()
def demo(
    seconds: Annotated[float, typer.Option(min=12, max=3600, help='Length of the scenario.')] = 30,
    seed: Annotated[int, typer.Option(min=0, help='Forces, contact point, noise, clocks.')] = 1001,
    device_seed: Annotated[
        int, typer.Option(min=0, help='Which virtual sensor: beads, gel, lamp, pixels.')
    ] = 1001,
    model: Annotated[
        OptionalPath, typer.Option(help='Weight file to use instead of the shipped one.')
    ] = None,
    json: Annotated[OptionalPath, typer.Option(help='Write the summary there as well.')] = None,
    out: Annotated[OptionalPath, typer.Option(help='New folder for bag, figure and logs.')] = None,
) -> None:
    """Bring the graph up on the virtual sensor, show it live, then measure and draw the run."""
    from mixtac_bringup.demo import Scenario, run_demo
    from mixtac_bringup.demo_summary import print_summary

    console = Console()
    now = dt.datetime.now().astimezone()
    folder = out or Path('demo_out') / f'{now:%Y%m%d-%H%M%S}'
    scenario = Scenario(seconds, seed, device_seed, model)
    report = run_demo(console, scenario, folder, json)
    print_summary(console, report, folder)


@up_commands.callback()
def up(
    context: typer.Context,
    device: Annotated[str, typer.Option(help='davis346, virtual or a recording.')] = 'davis346',
    namespace: Annotated[str, typer.Option(help='ROS namespace of all nodes.')] = 'mixtac',
    params_file: Annotated[
        OptionalPath, typer.Option(exists=True, help='Parameters that win over the shipped ones.')
    ] = None,
    log_level: Annotated[str, typer.Option(help='debug, info, warn, error or fatal.')] = 'info',
    seconds: Annotated[float, typer.Option(min=0, help='How long; 0 until Ctrl-C.')] = 0,
    record: Annotated[OptionalPath, typer.Option(help='Record to this new bag folder.')] = None,
    autostart: Annotated[bool, typer.Option(help='Configure and activate the estimator.')] = True,
    play: Annotated[
        bool, typer.Option(help='Play the scenario again and again (virtual device only).')
    ] = True,
    view: Annotated[bool, typer.Option(help='Live view in the browser; docs/viewing.md.')] = False,
    single_process: Annotated[
        bool, typer.Option(help='Driver and estimator in one process.')
    ] = False,
) -> None:
    """Run the sensor's nodes with their parameter files, as sensor.launch.py does."""
    if context.invoked_subcommand is not None:
        return
    from mixtac_bringup.up import UpOptions, run_graph

    options = UpOptions(
        device=device,
        namespace=namespace,
        params_file=params_file,
        log_level=log_level,
        seconds=seconds,
        record=record,
        autostart=autostart,
        play=play,
        view=view,
        single_process=single_process,
    )
    run_graph(Console(), options)


@app.command()
def inspect(bag: Annotated[Path, typer.Argument(help='Folder of a rosbag2 recording.')]) -> None:
    """Say what a recording holds, decode all of its events, and count what is missing."""
    from mixtac_bringup.bag_summary import summarise

    summary = summarise(bag)
    table = Table(title=f'{bag}, {summary.duration_s:.1f} s', title_justify='left')
    for heading in ('topic', 'type', 'messages', 'events', 'lost packets'):
        table.add_column(heading, justify='left' if heading in ('topic', 'type') else 'right')
    for topic, count in sorted(summary.counts.items()):
        events = summary.events.get(topic)
        table.add_row(
            topic,
            summary.types[topic],
            str(count),
            str(events.events) if events else '',
            str(events.lost_packets) if events else '',
        )
    Console().print(table)


def _mount_learning() -> None:
    # Training pulls in torch; the other commands start without it.
    from mixtac_bringup.align.learning_effect import alignment
    from mixtac_bringup.experiments import command as paper_experiments
    from mixtac_bringup.slip_bench.experiment import slip
    from mixtac_fger import adapt_cli, difficulty_cli, training_cli
    from mixtac_fger.experiments import models_cli
    from mixtac_sim import vibration_cli

    app.command()(training_cli.train)
    app.command()(training_cli.evaluate)
    app.command()(adapt_cli.adapt)
    for experiment in (
        difficulty_cli.difficulty,
        difficulty_cli.ablation,
        models_cli.models,
        models_cli.adaptation,
        alignment,
    ):
        experiments.command()(experiment)
    paper_experiments.mount(experiments)
    experiments.command('tones')(vibration_cli.vibration)
    experiments.command('grasps')(slip)


def _mount_hardware() -> None:
    # So does whatever opens cameras, or pretends to be one.
    from mixtac_bringup.align.command import align
    from mixtac_bringup.calibrate import calibrate
    from mixtac_bringup.doctor import doctor
    from mixtac_bringup.export.command import export
    from mixtac_bringup.record.command import record
    from mixtac_bringup.simulate.command import simulate
    from mixtac_bringup.slip_bench.up_slip import slip
    from mixtac_bringup.view.command import view

    for command in (doctor, calibrate, simulate, align, view, record, export):
        app.command()(command)
    up_commands.command()(slip)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: Without the program's name; None for those of the process.

    Returns:
        Exit status: 0, 1 after an expected failure (one line on stderr), 2 for wrong usage,
        130 after Ctrl-C.
    """
    _mount_learning()
    _mount_hardware()
    words = sys.argv[1:] if arguments is None else arguments
    if words[:1] == ['bench']:
        # Compiled code takes a second to load, which no other command should wait for.
        bench.mount()
    try:
        result = app(arguments, standalone_mode=False)
    except MixtacError as error:
        print(f'error: {error}', file=sys.stderr)
        return 1
    except typer.Exit as leave:
        return leave.exit_code
    except (typer.Abort, KeyboardInterrupt):
        print('interrupted', file=sys.stderr)
        return INTERRUPTED
    except Exception as error:
        if hasattr(error, 'format_message'):
            print(f'error: {error.format_message()}', file=sys.stderr)
            return 2
        raise
    return result if isinstance(result, int) else 0
