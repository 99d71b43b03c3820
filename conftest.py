# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fixtures that all packages share."""

from __future__ import annotations

import contextlib
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

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

ROOT = Path(__file__).resolve().parent
# 0 is everybody's default; above 100 the ports run into Linux's ephemeral range.
DOMAINS = range(1, 100)
PATIENCE_S = 60.0
LIVE = ('live', 'dds', 'umockdev')


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
    if config.option.markexpr != 'live' or collection_path.suffix != '.py':
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


class NodeUnderTest:
    """A node in its own process, and a node of the test that listens to it and calls it.

    Args:
        env: Environment of the process.

    Attributes:
        node: The node of the test.
        executor: Its executor.
        process: The process, None before `start`.
        got: Received messages by name of the topic.
    """

    def __init__(self, env: dict[str, str]) -> None:
        import rclpy
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor

        self._env = env
        self._context = Context()
        rclpy.init(context=self._context)
        self.node = rclpy.create_node('listener', context=self._context)
        self.executor = SingleThreadedExecutor(context=self._context)
        self.executor.add_node(self.node)
        self.process: subprocess.Popen[bytes] | None = None
        self.got: dict[str, list[Any]] = {}

    def start(self, command: list[str], *parameters: str, remap: tuple[str, ...] = ()) -> None:
        """Start the process.

        Args:
            command: Its command line, without ROS arguments.
            parameters: Parameters, as `name:=value`.
            remap: Remappings, as `from:=to`.
        """
        words = [word for each in parameters for word in ('-p', each)]
        words += [word for each in remap for word in ('-r', each)]
        self.process = subprocess.Popen(
            [*command, '--ros-args', *words],
            env=self._env,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )

    def listen(self, kind: Any, topic: str, qos: Any) -> list[Any]:  # noqa: ANN401
        """Subscribe to an absolute topic; return the list that its messages are appended to."""
        got = self.got.setdefault(topic, [])
        self.node.create_subscription(kind, topic, got.append, qos)
        return got

    def spin_until(self, condition: Callable[[], object], seconds: float = PATIENCE_S) -> None:
        """Receive until a condition holds; fail if it does not, or if the process ends."""
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, {k: len(v) for k, v in self.got.items()}
            if self.process is not None and self.process.poll() is not None:
                pytest.fail(self.process.stdout.read().decode())  # type: ignore[union-attr]
            self.executor.spin_once(timeout_sec=0.1)

    def call(self, kind: Any, name: str, request: Any) -> Any:  # noqa: ANN401
        """Call a service by its absolute name and return the answer."""
        client = self.node.create_client(kind, name)
        self.spin_until(client.service_is_ready)
        future = client.call_async(request)
        self.spin_until(future.done)
        return future.result()

    def diagnostics(self, name: str) -> dict[str, str]:
        """Return the latest diagnostics of a node, with keys `level` and `message`; or nothing.

        Args:
            name: For example `mixtac/driver`. The test listens to `/diagnostics`.
        """
        for array in reversed(self.got.get('/diagnostics', [])):
            for status in array.status:
                if status.name == name:
                    values = {each.key: each.value for each in status.values}
                    return {**values, 'level': str(status.level[0]), 'message': status.message}
        return {}

    def stop(self) -> tuple[int, str]:
        """Interrupt the process; return its exit status and output."""
        assert self.process is not None
        self.process.send_signal(signal.SIGINT)
        output, _ = self.process.communicate(timeout=30)
        return self.process.returncode, output.decode()

    def close(self) -> None:
        """End everything."""
        import rclpy

        if self.process is not None and self.process.poll() is None:
            # Killed, it would still be a peer of the node here, whose end then crashes at times.
            self.process.terminate()
            try:
                self.process.communicate(timeout=15)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)


@pytest.fixture
def node_under_test(ros_domain: dict[str, str]) -> Iterator[NodeUnderTest]:
    """Return a node process to start, with a node that listens to it, in a domain of its own."""
    graph = NodeUnderTest(ros_domain)
    yield graph
    graph.close()


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
        *('launch', 'launch.actions', 'launch.conditions', 'launch.event_handlers'),
        *('launch.events', 'launch.launch_description_sources', 'launch.substitutions'),
        *('launch_ros', 'launch_ros.actions', 'launch_ros.event_handlers', 'launch_ros.events'),
        *('launch_ros.events.lifecycle', 'launch_ros.substitutions'),
    )
    with mock.patch.dict(sys.modules, dict.fromkeys(modules, substitute)):
        sys.modules.pop('mixtac_node.launch_actions', None)
        runpy.run_path(str(path))
        sys.modules.pop('mixtac_node.launch_actions', None)
    return names


@pytest.fixture(scope='session')
def launch_arguments() -> Callable[[Path], list[str]]:
    """Return the function that names the arguments of a launch file."""
    return declared_launch_arguments


@pytest.fixture(scope='session')
def commands() -> dict[str, Any]:
    """Return every command of `mixtac` by the words that it is called with."""
    from mixtac_cli.main import group

    found: dict[str, Any] = {}

    def walk(command: Any, words: tuple[str, ...]) -> None:  # noqa: ANN401
        context = command.context_class(command, info_name=' '.join(('mixtac', *words)))
        if not hasattr(command, 'list_commands') or command.invoke_without_command:
            found[' '.join(words)] = command
        for name in command.list_commands(context) if hasattr(command, 'list_commands') else ():
            _, child, _ = command.resolve_command(context, [name])
            walk(child, (*words, name))

    walk(group(''), ())
    return found
