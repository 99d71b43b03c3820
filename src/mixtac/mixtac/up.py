# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Commands that run nodes until Ctrl-C: `mixtac up`, `mixtac up slip` and `mixtac view`.

`mixtac up` runs the graph of `sensor.launch.py` on machines without `ros2 launch`. `mixtac up slip`
runs slip control on a simulated grasp and arm over real DDS. There, slip control, arm and
supervisor follow the clock of the simulation (`/clock`), so that neither the watchdogs nor the
response to a disturbance depend on the speed of the host.
"""

from __future__ import annotations

import importlib.util
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Optional

import typer
from rich.console import Console
from rich.live import Live

from mixtac.figures import make_table
from mixtac.options import Namespace, OptionalPath, ParamsFile, Preset, RunTime
from mixtac_core.node.graph import NodeSpec, is_virtual, node, sensor_graph, slip_control
from mixtac_core.node.process import ProcessGroup
from mixtac_core.node.topics import DEFAULT_NAMESPACE

if TYPE_CHECKING:
    from mixtac.monitor_node import Monitor

POLL_S = 0.2
"""Time between two looks at processes, and between two updates of the live table [s]."""
LINE_PERIOD_S = 5.0
"""Time between two lines where the output is not a terminal [s]."""
SLIP_STOP_ORDER = ('supervisor', 'slip_control', 'fger', 'driver')
"""Stopped in this order, so that no node loses another that it needs."""


def start_nodes(
    processes: ProcessGroup,
    nodes: Sequence[NodeSpec],
    namespace: str = DEFAULT_NAMESPACE,
    params_file: Path | None = None,
    log_level: str = 'info',
) -> None:
    """Start the processes of nodes, the driver last; see `NodeSpec.command`.

    The driver of a virtual camera is started once the camera accepts connections; otherwise the
    driver would report a missing camera.

    Raises:
        GraphError: A parameter file does not exist, or a process has ended.
    """
    for each in sorted(nodes, key=lambda node: node.name == 'driver'):
        device = str(each.overrides.get('device', ''))
        if each.name == 'driver' and is_virtual(device):
            from mixtac_sim.usb.wire import default_socket_path  # not installed on robots

            while not Path(device.partition(':')[2] or default_socket_path()).exists():
                run_until(processes, POLL_S)
        processes.start(each.name, each.command(namespace, params_file, log_level))


def run_until(processes: ProcessGroup, seconds: float) -> None:
    """Wait while processes run.

    Args:
        processes: The processes.
        seconds: Time to wait [s]; 0 waits until interrupted.

    Raises:
        GraphError: A process has ended.
    """
    end = time.monotonic() + seconds
    while not seconds or time.monotonic() < end:
        time.sleep(POLL_S)
        processes.check()


def record_command(bag: Path, namespace: str) -> list[str]:
    """Return the command that records a sensor to a new bag, from its first event packet on."""
    words = ('record', str(bag), '--namespace', namespace, '--wait', 'inf')
    return [sys.executable, '-m', 'mixtac', *words]


def up(
    context: typer.Context,
    device: Annotated[
        str, typer.Option(help='davis346, virtual, or the path of a recording.')
    ] = 'davis346',
    namespace: Namespace = DEFAULT_NAMESPACE,
    params_file: ParamsFile = None,
    log_level: Annotated[
        Literal['debug', 'info', 'warn', 'error', 'fatal'],
        typer.Option(help='Lowest severity that the nodes log.'),
    ] = 'info',
    seconds: RunTime = 0,
    record: Annotated[OptionalPath, typer.Option(help='Record to this new bag folder.')] = None,
    model: Annotated[
        str,
        typer.Option(help='Weight file or name of a model; by default, see the parameter file.'),
    ] = '',
    play: Annotated[bool, typer.Option(help='Virtual sensor: play its scenario in a loop.')] = True,
    view: Annotated[
        bool, typer.Option(help='Show the sensor in the browser (needs `make view`).')
    ] = False,
) -> None:
    """Run the sensor's nodes with their parameter files, as sensor.launch.py does."""
    if context.invoked_subcommand is not None:
        return
    if importlib.util.find_spec('rclpy') is None:
        if record or view or params_file:
            raise typer.BadParameter('--record, --view and --params-file need ROS 2: `make setup`')
        source = {'davis346': 'usb', 'virtual': 'virtual:press'}.get(device, device)
        show_without_ros(source, model, seconds)
        return
    from mixtac.monitor_node import Monitor

    play = play and is_virtual(device)
    estimator = {'model': model} if model else {}
    virtual_sensor = {'loop': True} if play else {}
    nodes = sensor_graph(device, estimator=estimator, virtual_sensor=virtual_sensor, view=view)
    with ProcessGroup() as processes:
        if record is not None:
            processes.start('record', record_command(record, namespace))
        start_nodes(processes, nodes, namespace, params_file, log_level)
        with Monitor(namespace, processes) as monitor:
            monitor.listen()

            def estimates() -> bool:
                # Without a known zero, forces are estimated and not published.
                rate_hz = float(monitor.values('fger').get('rate_hz', 0.0))
                return monitor.estimate.received > 0 or rate_hz > 0.0

            monitor.wait(estimates, 'the first force')
            if play:
                monitor.trigger('virtual_sensor/play')
            console = Console(markup=False)
            console.print(
                f'sensor active in namespace /{namespace.strip("/")}; press Ctrl-C to stop'
            )
            if is_virtual(device) or console.is_terminal:

                def values() -> dict[str, str]:
                    processes.check()
                    return sensor_values(monitor, is_virtual(device))

                show(console, time_left(seconds), values)
                return
        run_until(processes, seconds)


def show_without_ros(source: str, model: str, seconds: float) -> list[tuple[float, float]]:
    """Show the force of a sensor in the terminal: without ROS nothing is published.

    Args:
        source: As for `Sensor`.
        model: Weight file or name of a model; empty for the default.
        seconds: Duration from the first force on [s, clock of the sensor]; 0 runs until
            interrupted.

    Returns:
        Estimated and simulated force of a virtual sensor, several times a second [N].
    """
    from mixtac.sensor import Sensor

    console, forces = Console(markup=False), []
    console.print('without ROS: forces are shown and not published; a first start compiles')
    with Sensor(source, model=model) as sensor:

        def values() -> dict[str, str]:
            reading = sensor.read()
            shown = {'force': str(reading)}
            if sensor.virtual is not None:
                true_n = sensor.virtual.true_force(reading.stamp_us)
                forces.append((reading.force, true_n))
                shown['simulated'] = f'{true_n:.3f} N'
            return shown

        # By the sensor's time: the virtual sensor waits for a busy host.
        show(console, time_left(seconds, lambda: 1e-6 * sensor.read().stamp_us), values)
    return forces


def time_left(seconds: float, now_s: Callable[[], float] = time.monotonic) -> Callable[[], str]:
    """Return a function that returns the remaining time as text, and an empty text at the end.

    Args:
        seconds: Duration from now on [s]; 0 runs until interrupted.
        now_s: Returns the time [s].
    """
    end_s = now_s() + seconds

    def doing() -> str:
        left_s = end_s - now_s()
        if not seconds:
            return 'press Ctrl-C to stop'
        return f'{left_s:.0f} s left' if left_s > 0.0 else ''

    return doing


def show(
    console: Console, doing: Callable[[], str], values: Callable[[], Mapping[str, str]]
) -> None:
    """Show values until `doing` returns an empty text: a table in a terminal, else lines.

    Args:
        console: Where to show them.
        doing: Returns the present state of the sensor. Called several times a second, as `values`.
        values: Returns what to show, by name.
    """
    terminal, due_s = console.is_terminal, time.monotonic()
    table = Live(console=console)
    with table if terminal else nullcontext():
        while text := doing():
            shown = values().items()
            if terminal:
                table.update(make_table(f'Mixtac: {text}', ('', ''), shown, words=2))
            elif time.monotonic() >= due_s:
                due_s += LINE_PERIOD_S
                line = '  '.join(f'{name} {value}' for name, value in shown)
                console.print(f'{text}: {line}', soft_wrap=True)
            time.sleep(POLL_S)


def sensor_values(monitor: Monitor, reference: bool) -> dict[str, str]:
    """Return forces and rates of a running graph for `show`.

    Args:
        monitor: Listens to the graph.
        reference: Show the reference force too.
    """
    shown = {'estimate': f'{monitor.estimate.latest_n:7.3f} N'}
    if reference:
        shown['reference'] = f'{monitor.measured.latest_n:7.3f} N'
    rates = [('fger', 'rate_hz', 'forces/s')]
    rates += [('driver', f'{key} per second', f'{key}/s') for key in ('events', 'frames')]
    for name, key, unit in rates:
        if key in (found := monitor.values(name)):
            shown[unit] = f'{float(found[key]):.0f}'
    return shown


def slip(
    object_name: Annotated[
        Literal['box', 'cup', 'ball'], typer.Option('--object', help='Held object.')
    ] = 'box',
    disturb: Annotated[
        float,
        typer.Option(
            '--disturb', min=0.0, max=500.0, help='Speed of each impact (mm/s); 0 for none.'
        ),
    ] = 50.0,
    every: Annotated[
        float, typer.Option(min=0.0, max=3600.0, help='Least time between impacts (s); 0 for none.')
    ] = 1.0,
    preset: Preset = 'paper_like',
    seed: Annotated[
        int,
        typer.Option(min=0, max=9_999_999, help='Random seed for sensor, trial and object.'),
    ] = 1,
    press: Annotated[
        bool, typer.Option(help='Press before any slip, or only answer slips.')
    ] = True,
    figure: Annotated[
        OptionalPath, typer.Option(help='Draw force and object around the latest impact.')
    ] = None,
    seconds: RunTime = 0.0,
) -> None:
    """Run the real driver, estimator and slip control on a simulated grasp that is struck."""
    from mixtac.monitor_node import Monitor

    simulated = {'use_sim_time': True}
    with tempfile.TemporaryDirectory(prefix='mixtac-') as folder, ProcessGroup() as processes:
        socket = Path(folder) / 'usb.sock'
        # The grasp publishes the joint states once the fingertip has reached them.
        arm_topic = '/virtual_arm/joint_states'
        grasp = {
            'arm_topic': arm_topic,
            'object': object_name,
            'knock': disturb,
            'preset': preset,
            'device_seed': seed,
            'seed': seed,
            'socket': str(socket),
            'publish_clock': True,
        }
        reach = {'normal_frame': 'base', 'normal': '0 1 0'}
        grip = {} if press else {'grip_margin': 1.0}
        arm = {'joint_state_topic': arm_topic, **simulated}
        knocks = {'knock_every': every if disturb > 0.0 else 0.0, **simulated}
        drawn = {} if figure is None else {'figure': str(figure.absolute())}
        # The contact is not needed, and costs as much as the force.
        *_, driver, fger = sensor_graph(
            f'virtual:{socket}', estimator={'contact': False}, simulated_time=True
        )
        nodes = [
            node('mixtac_sim', 'virtual_grasp', overrides=grasp),
            slip_control({'arm': 'fr3', **reach, **grip, **simulated}),
            node('mixtac_sim', 'virtual_arm', overrides=arm),
            node('mixtac', 'supervisor', overrides={**knocks, **drawn}),
            fger,
            driver,
        ]
        start_nodes(processes, nodes)
        try:
            with Monitor(DEFAULT_NAMESPACE, processes) as monitor:
                monitor.listen()
                monitor.wait(
                    lambda: monitor.values('slip_control').get('trajectories', '0') != '0',
                    'slip control to be enabled',
                )
            run_until(processes, seconds)
        finally:
            for name in SLIP_STOP_ORDER:
                processes.stop(name)


def view(
    namespace: Namespace = DEFAULT_NAMESPACE,
    port: Annotated[
        Optional[int],  # noqa: UP045  (typer evaluates this under Python 3.10)
        typer.Option(
            min=0, max=65535, help='Port of the page on 127.0.0.1 (0: any free one); 9090 if unset.'
        ),
    ] = None,
    save: Annotated[
        OptionalPath, typer.Option(help='Write to this new .rrd file instead of serving a page.')
    ] = None,
    seconds: RunTime = 0,
    params_file: ParamsFile = None,
) -> None:
    """Show a running sensor in the browser: events, frame, force, contact, state."""
    options = {'port': port, 'save': save and str(save)}
    given = {name: value for name, value in options.items() if value is not None}
    with ProcessGroup() as processes:
        start_nodes(processes, [node('mixtac', 'view', overrides=given)], namespace, params_file)
        Console().print('starting the view; press Ctrl-C to stop')
        while save is not None and not save.exists():
            run_until(processes, POLL_S)
        run_until(processes, seconds)
