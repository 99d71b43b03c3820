# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A disturbed run through Franka's own client against an independent control unit, over loopback.

Runs where `MIXTAC_FRANKA_PYTHON`, or `.venv-franka`, has what requirements/franka.txt lists. The
simulated control unit gives up where its client is silent for 100 ms, so a run tells of our stream
only where the host did not stall: how late it woke this process is measured beside it.
"""

import importlib.util
import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from fr3_mjcf import fr3_mjcf

from mixtac_slip_control.arm.libfranka import LibfrankaBackend
from mixtac_slip_control.arm.libfranka_loop import JOINTS, STATE
from mixtac_slip_control.arm.model import make_arm
from mixtac_slip_control.arm.trajectory import PlannedTrajectory
from mixtac_slip_control.errors import BackendError
from mixtac_slip_control.parameters import SlipControlParameters

HERE = Path(__file__).resolve().parent
VENV = HERE.parents[3] / '.venv-franka' / 'bin' / 'python'
PYTHON = os.environ.get('MIXTAC_FRANKA_PYTHON', str(VENV))
ADDRESS, PORT = '127.0.0.1', 1337
X = np.array([1.0, 0.0, 0.0])
RUN_S = 5.0
CYCLES_S = 2e-3
"""Part of a lead that the control loop needs; the rest is for the host."""
STALL_S = 0.03
"""The host woke a waiting thread so much too late: enough, several times in a row, for the control
unit to miss its client."""


def answers():
    with socket.socket() as probe:
        return probe.connect_ex((ADDRESS, PORT)) == 0


@pytest.fixture
def control_unit(tmp_path):
    probe = [PYTHON, '-c', 'import franka_sim, pylibfranka']
    if not Path(PYTHON).exists() or subprocess.run(probe, check=False).returncode:
        pytest.skip('no franka-sim: make .venv-franka from requirements/franka.txt')
    if answers():
        pytest.skip(f'port {PORT} on {ADDRESS} is taken, and libfranka knows no other')
    model, log = tmp_path / 'fr3.xml', tmp_path / 'server.log'
    model.write_text(fr3_mjcf())
    with log.open('w') as stream:
        server = subprocess.Popen(
            [PYTHON, str(HERE / 'franka_server.py'), str(model)], stdout=stream, stderr=stream
        )
        try:
            deadline = time.monotonic() + 60.0
            while not answers():
                assert server.poll() is None, log.read_text()
                assert time.monotonic() < deadline, log.read_text()
                time.sleep(0.1)
            yield log
        finally:
            server.terminate()
            server.wait()


class HostWatch:
    """Measures how late the host wakes a thread that asked for the next millisecond."""

    def __init__(self):
        self.late_s = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()

    def _run(self):
        while not self._stop.is_set():
            due = time.monotonic() + 1e-3
            time.sleep(1e-3)
            self.late_s.append(time.monotonic() - due)

    def words(self):
        p50, p99, worst = 1e3 * np.quantile(self.late_s, [0.5, 0.99, 1.0])
        return f'host woke late by p50 {p50:.1f}, p99 {p99:.1f}, at most {worst:.1f} ms'


def resting(backend):
    """Return the commanded positions once they no longer change."""
    before = backend.state().commanded
    for _ in range(200):
        time.sleep(0.2)
        after = backend.state().commanded
        if (after == before).all():
            return after
        before = after
    pytest.fail('the arm does not come to rest')


def disturbed_run(backend, words, lead_s):
    """Stream random advances for a while; return how many, and how far the arm went [m]."""
    parts = make_arm(SlipControlParameters(arm='libfranka', lead=lead_s))
    arm, planner = parts.arm, parts.planner
    state = backend.state()
    planner.reset(state.commanded, X)
    place = arm.pose(state.commanded)[0, 3]
    rng = np.random.default_rng(1)
    advance, sent, late, farthest = 0.0, 0, 0, 0.0
    ends = time.monotonic() + RUN_S
    while time.monotonic() < ends:
        if rng.random() < 0.3:
            advance = float(np.clip(advance + rng.normal() * 3e-4, 0.0, 5e-3))
        trajectory = planner.plan(time.time(), advance, X)
        try:
            if trajectory is not None:
                backend.send(trajectory)
                sent += 1
            farthest = max(farthest, arm.pose(backend.state().q)[0, 3] - place)
        except BackendError as error:
            # A simulation that catches up after a stall runs ahead of the host's clock.
            if 'too late' not in str(error):
                raise
            late += 1
            planner.reset(resting(backend), X)
            advance = 0.0
        time.sleep(0.01)
    deadline = time.monotonic() + 30.0
    goal = planner.path.derivatives(planner.target)[0]
    while not np.allclose(backend.state().commanded, goal, atol=1e-9):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert 'violat' not in words.read_text()
    assert 'aborting' not in words.read_text()
    return sent, late, farthest


@pytest.mark.parametrize('lead_s', [SlipControlParameters().lead, 3e-3])
def test_a_disturbed_run_has_no_reflex_discontinuity_or_communication_error(control_unit, lead_s):
    with HostWatch() as host:
        backend = None
        try:
            make_arm(SlipControlParameters(arm='libfranka'))  # compiles, which takes its time
            backend = LibfrankaBackend(ADDRESS, PYTHON)
            sent, late, farthest = disturbed_run(backend, control_unit, lead_s)
        except (BackendError, AssertionError) as error:
            allowed_s = lead_s - CYCLES_S if 'too late' in str(error) else STALL_S
            if max(host.late_s) < allowed_s:
                raise
            pytest.skip(f'no verdict, {host.words()}: {error}')
        finally:
            if backend is not None:
                backend.stop()
    print(f'{sent} trajectories, {late} late, {1e3 * farthest:.2f} mm at most; {host.words()}')
    if late and max(host.late_s) >= lead_s - CYCLES_S:
        pytest.skip(f'no verdict on a lead of {1e3 * lead_s:g} ms, {host.words()}')
    assert late == 0
    assert sent > 50
    assert farthest > 3e-4


def test_a_process_that_takes_no_trajectories_is_ended(tmp_path):
    """Its states go on, but nothing that is sent to it is read."""
    child, interpreter = tmp_path / 'child.py', tmp_path / 'python'
    child.write_text(
        'import os, struct, time\n'
        'while os.getppid() > 1:\n'
        f'    state = struct.pack({STATE.format!r}, time.time_ns(), 0, *[0.0] * {3 * JOINTS})\n'
        '    os.write(1, state)\n'
        '    time.sleep(0.01)\n'
    )
    interpreter.write_text(f'#!/bin/sh\nexec {sys.executable} {child}\n')
    interpreter.chmod(0o755)
    rest = np.zeros((600, JOINTS))
    times = 1e-3 * np.arange(1, 601)
    trajectory = PlannedTrajectory(0, times, rest, rest, rest, tuple('1234567'))
    backend = LibfrankaBackend(ADDRESS, str(interpreter))
    backend.send(trajectory)

    def send_on():
        for _ in range(1000):
            backend.send(trajectory)

    with pytest.raises(BackendError) as caught:
        send_on()
    assert caught.value.remedy
    backend.stop()
    with pytest.raises(BackendError):
        backend.state()


def test_a_missing_client_library_is_named():
    if importlib.util.find_spec('pylibfranka'):
        pytest.skip('pylibfranka is installed here')
    with pytest.raises(BackendError):
        LibfrankaBackend(ADDRESS)
