# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fixtures that all packages share."""

from __future__ import annotations

import contextlib
import faulthandler
import fcntl
import os
import runpy
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest import mock

import pytest
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).resolve().parent
sys.path.insert(0, str(ROOT / 'test'))

from fork_server import ForkServer, NodeProcess  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from mixtac_core.node.graph import NodeSpec

# 0 is everybody's default; above 100 the ports run into Linux's ephemeral range.
DOMAINS = range(1, 100)
PATIENCE_S = 120.0
"""The first process of a module may have to compile."""
REPLY_S = 20.0
LIVE = ('live', 'dds', 'umockdev')
HANGING_S = 60.0
"""Time after the timeout of a live test at which its process ends: no signal ends a call that hangs
in the middleware (Fast DDS 2.14 has dead locks between discovery and destruction)."""

# A busy host may take its time.
settings.register_profile('mixtac', deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile('mixtac')


def pytest_configure(config: pytest.Config) -> None:
    """Remove compiled kernels older than a module beside them: numba checks their own file only."""
    if hasattr(config, 'workerinput'):
        return
    for index in (ROOT / 'src').rglob('*.nbi'):
        compiled_s = index.stat().st_mtime
        if any(path.stat().st_mtime > compiled_s for path in index.parent.parent.glob('*.py')):
            index.unlink(missing_ok=True)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave files without a test that runs in real time alone where only such tests are wanted."""
    if not config.option.markexpr.startswith('live') or collection_path.suffix != '.py':
        return None
    text = collection_path.read_text(encoding='utf-8')
    return None if any(f'mark.{kind}' in text for kind in LIVE) else True


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests that run in real time, keep each file with one worker, begin with slow files."""
    slow = {item.path for item in items if any(item.iter_markers('slow'))}
    items.sort(key=lambda item: item.path not in slow)
    for item in items:
        item.add_marker(pytest.mark.xdist_group(item.path.name))
        if any(any(item.iter_markers(kind)) for kind in LIVE):
            item.add_marker('live')


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """End the process of a live test that hangs, with a traceback in log/hanging_test.txt."""
    if item.get_closest_marker('live') is None:
        return (yield)
    limit = item.get_closest_marker('timeout')
    seconds = float(limit.args[0] if limit else item.config.getini('timeout')) + HANGING_S
    path = ROOT / 'log' / 'hanging_test.txt'
    path.parent.mkdir(exist_ok=True)
    with path.open('a') as traceback:
        faulthandler.dump_traceback_later(seconds, exit=True, file=traceback)
        try:
            return (yield)
        finally:
            faulthandler.cancel_dump_traceback_later()


@contextlib.contextmanager
def leased_domain() -> Iterator[dict[str, str]]:
    """Lease a ROS domain id, set it for this process, and yield the environment."""
    folder = Path(tempfile.gettempdir()) / f'mixtac-domains-{os.getuid()}'
    folder.mkdir(exist_ok=True)
    for domain in DOMAINS:
        with (folder / str(domain)).open('w') as lease:
            try:
                fcntl.flock(lease, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            with pytest.MonkeyPatch.context() as patch:
                patch.setenv('ROS_DOMAIN_ID', str(domain))
                patch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
                yield dict(os.environ)
            return
    pytest.fail(f'all {len(DOMAINS)} ROS domains are leased by running tests')


@pytest.fixture
def ros_domain() -> Iterator[dict[str, str]]:
    """Lease a ROS domain for one test, discovered on this machine only.

    The variables are set for the test's process; the environment is also yielded, for processes
    that the test starts.
    """
    with leased_domain() as env:
        yield env


@pytest.fixture(scope='module')
def module_ros_domain() -> Iterator[dict[str, str]]:
    """Lease a ROS domain for all tests of a module that share one running graph."""
    with leased_domain() as env:
        yield env


@pytest.fixture(scope='session')
def fork_server() -> Iterator[ForkServer]:
    """Return the server that forks node processes; it starts with the first test that needs it."""
    server = ForkServer()
    yield server
    server.close()


class NodeUnderTest:
    """Nodes in processes of their own, and a node of the test that listens to them and calls them.

    Args:
        server: Forks the processes.

    Attributes:
        node: The node of the test.
        executor: Its executor.
        process: The process that was started last, None before the first.
        got: Received messages by name of the topic.
    """

    def __init__(self, server: ForkServer) -> None:
        rclpy = pytest.importorskip('rclpy', reason='needs ROS 2')
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor

        self._server = server
        self._context = Context()
        rclpy.init(context=self._context)
        self.node = rclpy.create_node('listener', context=self._context)
        self.executor = SingleThreadedExecutor(context=self._context)
        self.executor.add_node(self.node)
        self._processes: list[NodeProcess] = []
        self._clients: dict[str, Any] = {}
        self.got: dict[str, list[Any]] = {}

    @property
    def process(self) -> NodeProcess:
        return self._processes[-1]

    def start(self, module: str, *parameters: str, remap: tuple[str, ...] = ()) -> None:
        """Start a process, with the test's environment.

        Args:
            module: The node's module.
            parameters: Parameters, as `name:=value`.
            remap: Remappings, as `from:=to`.
        """
        words = [word for each in parameters for word in ('-p', each)]
        words += [word for each in remap for word in ('-r', each)]
        self._processes.append(NodeProcess(self._server, module, '--ros-args', *words))

    def start_nodes(self, nodes: Iterable[NodeSpec], namespace: str) -> None:
        """Start the processes of a graph, as their executables would."""
        for each in nodes:
            command = each.command(namespace)
            arguments = command[command.index(each.module) + 1 :]
            self._processes.append(NodeProcess(self._server, each.module, *arguments))

    def check(self) -> None:
        """Fail if a process has ended."""
        for each in self._processes:
            if each.poll() is not None:
                pytest.fail(f'status {each.returncode}: {each.stdout}{each.stderr}')

    def listen(self, kind: Any, topic: str, qos: Any) -> list[Any]:  # noqa: ANN401
        """Subscribe to an absolute topic; return the list that its messages are appended to."""
        got = self.got.setdefault(topic, [])
        self.node.create_subscription(kind, topic, got.append, qos)
        return got

    def spin_until(
        self,
        condition: Callable[[], object],
        action: Callable[[], object] | None = None,
    ) -> None:
        """Receive until a condition holds; fail if it does not, or if a process ends.

        Args:
            condition: The condition.
            action: Called meanwhile, again and again.
        """
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline, {k: len(v) for k, v in self.got.items()}
            self.check()
            if action is not None:
                action()
            self.executor.spin_once(timeout_sec=0.02 if action else 0.1)

    def call(self, kind: Any, name: str, request: Any = None) -> Any:  # noqa: ANN401
        """Call a service and return the answer; without one for 20 s, it is asked again.

        Args:
            kind: Its type.
            name: Its absolute name.
            request: The request, None for one with all defaults.
        """
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
        client, futures = self._clients[name], []
        self.spin_until(client.service_is_ready)
        request, asked = kind.Request() if request is None else request, float('-inf')

        def answers() -> list[Any]:
            # A reply is lost when the server has not discovered the client yet.
            nonlocal asked
            if time.monotonic() > asked + REPLY_S:
                asked = time.monotonic()
                futures.append(client.call_async(request))
            return [each.result() for each in futures if each.done()]

        self.spin_until(answers)
        return answers()[0]

    def change(self, node: str, **values: Any) -> Any:  # noqa: ANN401
        """Set parameters of a node together; return the result.

        Args:
            node: Its absolute name.
            values: The parameters.
        """
        from rcl_interfaces.srv import SetParametersAtomically
        from rclpy.parameter import Parameter

        parameters = [Parameter(name, value=value) for name, value in values.items()]
        request = SetParametersAtomically.Request()
        request.parameters = [each.to_parameter_msg() for each in parameters]
        return self.call(
            SetParametersAtomically, f'{node}/set_parameters_atomically', request
        ).result

    def diagnostics(self, name: str) -> dict[str, str]:
        """Return a node's latest diagnostics, or nothing.

        Args:
            name: For example `mixtac/driver`. The test listens to `/diagnostics`.

        Returns:
            Values by key, and `level`, `message` and `hardware_id`.
        """
        for array in reversed(self.got.get('/diagnostics', [])):
            for status in array.status:
                if status.name == name:
                    values = {each.key: each.value for each in status.values}
                    values.update(level=str(status.level[0]), message=status.message)
                    return {**values, 'hardware_id': status.hardware_id}
        return {}

    def stop(self) -> tuple[int, str]:
        """Interrupt the process; return its exit status and output."""
        status = self.process.end(signal.SIGINT)
        return status, self.process.stdout + self.process.stderr

    def close(self) -> None:
        """End everything; fail if a process whose end the test has not seen does not end well."""
        import rclpy

        left = [each for each in reversed(self._processes) if each.returncode is None]
        for each in left:
            # Killed, it would still be a peer of the node here, whose end then crashes at times.
            each.end()
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)
        for each in left:
            assert each.returncode == 0, each.stdout + each.stderr


@pytest.fixture
def node_under_test(
    ros_domain: dict[str, str],  # noqa: ARG001
    fork_server: ForkServer,
) -> Iterator[NodeUnderTest]:
    """Return node processes to start, with a node that listens, in a domain of their own."""
    with contextlib.closing(NodeUnderTest(fork_server)) as graph:
        yield graph


@pytest.fixture(scope='module')
def module_node_under_test(
    module_ros_domain: dict[str, str],  # noqa: ARG001
    fork_server: ForkServer,
) -> Iterator[NodeUnderTest]:
    """Return what `node_under_test` does, for all tests of a module."""
    with contextlib.closing(NodeUnderTest(fork_server)) as graph:
        yield graph


def declared_launch_arguments(path: Path) -> list[str]:
    """Return the names of the launch arguments that a launch file declares.

    The file runs with substitutes for `launch` and `launch_ros`, which need not be installed.
    """
    names: list[str] = []

    def declare(name: str, **_: object) -> str:
        names.append(name)
        return name

    substitute = mock.MagicMock(DeclareLaunchArgument=declare)
    modules = (
        *('launch', 'launch.actions', 'launch.event_handlers', 'launch.events'),
        *('launch.launch_description_sources', 'launch.logging', 'launch.substitutions'),
        *('launch_ros', 'launch_ros.actions', 'launch_ros.substitutions'),
    )
    with mock.patch.dict(sys.modules, dict.fromkeys(modules, substitute)):
        sys.modules.pop('mixtac_core.node.launch_actions', None)
        runpy.run_path(str(path))
        sys.modules.pop('mixtac_core.node.launch_actions', None)
    return names


@pytest.fixture(scope='session')
def launch_arguments() -> Callable[[Path], list[str]]:
    """Return the function that names the arguments of a launch file."""
    return declared_launch_arguments


@pytest.fixture(scope='session')
def commands() -> dict[str, Any]:
    """Return every command of `mixtac` by the words that it is called with."""
    from mixtac.main import root

    found: dict[str, Any] = {}

    def walk(command: Any, words: tuple[str, ...]) -> None:  # noqa: ANN401
        context = command.context_class(command, info_name=' '.join(('mixtac', *words)))
        if not hasattr(command, 'list_commands') or command.invoke_without_command:
            found[' '.join(words)] = command
        for name in command.list_commands(context) if hasattr(command, 'list_commands') else ():
            _, child, _ = command.resolve_command(context, [name])
            walk(child, (*words, name))

    walk(root(), ())
    return found


@pytest.fixture
def run_example(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> Callable[..., str]:
    """Return a function that runs an example and returns what it prints.

    It runs in the test's process, and so do the commands of `mixtac` that it starts.
    """
    from mixtac.main import main

    def call(command: list[Any], **options: Any) -> Any:  # noqa: ANN401
        if command[1:3] != ['-m', 'mixtac']:
            return start(command, **options)
        assert main(list(map(str, command[3:]))) == 0
        return None

    def run(name: str, *words: Any) -> str:  # noqa: ANN401
        pytest.importorskip('matplotlib').use('Agg')
        monkeypatch.setattr(sys, 'argv', [name, *map(str, words)])
        runpy.run_path(str(ROOT / 'examples' / f'{name}.py'), run_name='__main__')
        return capsys.readouterr().out

    start = subprocess.run
    monkeypatch.setattr(subprocess, 'run', call)
    monkeypatch.chdir(tmp_path)
    return run
