# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters, diagnostics and the run loop on a real rclpy node in its own process."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac_core.node.process import fatal_text
from mixtac_core.node.topics import ns_to_stamp, stamp_to_ns, stamp_to_us, us_to_stamp

PATIENCE_S = 120.0
NODE = textwrap.dedent(
    """
    import ctypes
    import sys
    import time
    from dataclasses import dataclass
    from rclpy.node import Node
    from std_msgs.msg import Empty
    from mixtac_core.events.errors import MixtacError
    from mixtac_core.node.base_node import BaseNode, declare, run
    from mixtac_core.node.diagnostics import OK, DiagnosticsPublisher, Status
    from mixtac_core.node.parameters import parameter
    from mixtac_core.node.topics import Topic

    BURST = 150

    @dataclass(frozen=True)
    class Example:
        gain: float = parameter(0.5, within=(0.0, 10.0))
        device: str = parameter('a', read_only=True)

    class ExampleNode(BaseNode, Node):
        def __init__(self):
            super().__init__('example', namespace='/')
            self.values = declare(self, Example, self.apply)
            if self.values.device == 'broken':
                raise MixtacError('device broken: choose another')
            if self.values.device == 'compiling':
                self.work()
            if self.values.device == 'wrapping':
                try:
                    self.work()
                except BaseException as error:
                    raise MixtacError('a library failed') from error
            self.diagnostics = DiagnosticsPublisher(self, 'serial-7', self.status)
            if self.values.device == 'stuck':
                # Holds the interpreter's lock, as a call that hangs in the middleware does.
                self.create_timer(0.1, lambda: ctypes.PyDLL(None).sleep(60))
            if self.values.device == 'overloaded':
                burst, self.left = Topic('burst', 'std_msgs/msg/Empty', True, BURST), BURST
                self.publisher = self.publish_topic(burst)
                self.subscribe_topic(burst, self.fall_behind)
                self.once = self.create_timer(0.1, self.flood)
            if self.values.device == 'busy':
                self.create_timer(0.1, self.work)

        def work(self):
            print('working', flush=True)
            # A signal just before a sleep does not interrupt it: many short ones.
            for _ in range(6000):
                time.sleep(0.01)

        def flood(self):
            if self.publisher.get_subscription_count():
                self.once.cancel()
                for _ in range(BURST):
                    self.publisher.publish(Empty())

        def fall_behind(self, _):
            time.sleep(0.02)
            self.left -= 1
            if not self.left:
                print('caught up', flush=True)

        def apply(self, values):
            if values.gain == 3.0:
                raise MixtacError('gain 3 is taken')
            self.values = values

        def status(self):
            return Status(OK, 'running', {'gain': self.values.gain, 'frames': 3})

        def close(self):
            print('closed', flush=True)

    sys.exit(run(ExampleNode))
    """
)


@pytest.fixture
def start(ros_domain: dict[str, str]):
    """Return a function that starts the example node; all are ended by pid."""
    started: list[subprocess.Popen[str]] = []

    def run(*parameters: str, before: str = '') -> subprocess.Popen[str]:
        command = [sys.executable, '-c', before + NODE, '--ros-args']
        for each in parameters:
            command += ['-p', each]
        process = subprocess.Popen(
            command, env=ros_domain, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        started.append(process)
        return process

    yield run
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


@given(st.integers(0, 2**31 * 1_000_000_000 - 1))
def test_stamps_round_trip(t_ns: int):
    assert stamp_to_us(us_to_stamp(t_ns // 1000)) == t_ns // 1000
    assert stamp_to_ns(ns_to_stamp(t_ns)) == t_ns
    assert stamp_to_us(ns_to_stamp(t_ns)) == t_ns // 1000


def test_errors_are_one_line_and_a_status(start):
    process = start('device:=broken')
    _, stderr = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1
    assert 'error: device broken: choose another' in stderr.splitlines()
    assert 'Traceback' not in stderr


@pytest.mark.parametrize('device', ['compiling', 'wrapping', 'busy'])
def test_a_signal_ends_what_takes_long(start, device):
    process = start(f'device:={device}')
    assert process.stdout.readline() == 'working\n'
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, stderr) == (0, '')


QUICK = 'import mixtac_core.node.process as process; process.STUCK_S = 1.0'


def test_a_node_that_is_late_goes_on(start):
    process = start('device:=overloaded', before=QUICK)
    assert process.stdout.readline() == 'caught up\n'
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, stderr) == (0, '')


def test_a_callback_that_never_returns_ends_the_process(start):
    process = start('device:=stuck', before=QUICK)
    _, stderr = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1
    assert fatal_text(stderr.splitlines()[0])
    assert '<lambda>' in stderr


def test_a_blocked_interrupt_waits_for_the_end_of_the_imports(start):
    # As the launch files start nodes.
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    process = start()
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, stderr) == (0, '')


def test_security_without_keys_is_refused_with_one_line(start, ros_domain, tmp_path):
    ros_domain |= {'ROS_SECURITY_ENABLE': 'true', 'ROS_SECURITY_STRATEGY': 'Enforce'}
    process = start()
    ros_domain['ROS_SECURITY_KEYSTORE'] = str(tmp_path)
    for each in (process, start()):
        _, stderr = each.communicate(timeout=PATIENCE_S)
        assert each.returncode == 1
        assert len([line for line in stderr.splitlines() if line.startswith('error: ')]) == 1
        assert 'ROS_SECURITY_ENABLE' in stderr
        assert 'Traceback' not in stderr


@pytest.mark.parametrize('value', ['gain:=99.0', 'gain:=fast', 'gain:=[1, fast]'])
def test_bad_start_values_are_refused(start, value: str):
    process = start(value)
    _, stderr = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1
    assert 'error: ' in stderr
    assert 'gain' in stderr
    assert 'Traceback' not in stderr


@pytest.mark.dds
def test_parameters_and_diagnostics_over_dds(start, node_under_test):
    from diagnostic_msgs.msg import DiagnosticArray
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    process = start('gain:=2')
    node_under_test.listen(DiagnosticArray, '/diagnostics', 10)

    def set_value(name: str, value: object):
        request = SetParameters.Request()
        request.parameters = [Parameter(name, value=value).to_parameter_msg()]
        return node_under_test.call(SetParameters, '/example/set_parameters', request).results[0]

    assert set_value('gain', 4.0).successful
    refused = set_value('gain', 3.0)
    assert not refused.successful
    assert refused.reason == 'gain 3 is taken'
    request = SetParameters.Request(parameters=[Parameter('gain', value=1.0).to_parameter_msg()])
    request.parameters[0].value.type = 255
    # rclpy raises for it instead of an answer; the node goes on.
    node_under_test.node.create_client(SetParameters, '/example/set_parameters').call_async(request)
    fixed = set_value('device', 'b')
    assert not fixed.successful
    assert 'device' in fixed.reason
    node_under_test.spin_until(lambda: node_under_test.diagnostics('example').get('gain') == '4')
    assert node_under_test.diagnostics('example') == {
        'gain': '4',
        'frames': '3',
        'level': '0',
        'message': 'running',
        'hardware_id': 'serial-7',
    }
    process.send_signal(signal.SIGTERM)
    stdout, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert 'closed' in stdout
