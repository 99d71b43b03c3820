# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The arm backend for a Franka arm without ros2_control, through pylibfranka. Experimental.

It is tested against Franka's own client with an independent simulation of the control unit, and has
not driven a real arm yet.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np

import mixtac_events
import mixtac_slip_control
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.libfranka_loop import JOINTS, STATE, STOP, pack
from mixtac_slip_control.arm.trajectory import ArmState, PlannedTrajectory
from mixtac_slip_control.errors import BackendError
from mixtac_slip_control.parameters import SlipControlParameters

PACKAGES = tuple(
    str(Path(str(package.__file__)).resolve().parents[1])
    for package in (mixtac_slip_control, mixtac_events)
)
"""Where another interpreter finds these packages, before its own ones."""
READY_S = 20.0
"""Longest wait for the first state of the robot."""
PIPE_BYTES = 1 << 20
"""Room for trajectories that the process has not read yet: the largest have 100 kB."""
STOP_S = 5.0
"""Longest wait for the arm to come to rest on request."""


class LibfrankaBackend:
    """An `ArmBackend` on the Franka control interface.

    The loop that must answer the robot within a millisecond runs in a process of its own
    (`libfranka_loop`). Stamps of trajectories are on this host's `time.time_ns`.

    Args:
        address: Address of the control unit, for example '172.16.0.2'.
        interpreter: Python that has pylibfranka and NumPy; default: this one.
        realtime: Refuse to run on a kernel without real-time scheduling, as Franka advises.

    Raises:
        BackendError: The library is missing, or the robot does not answer or is not ready.
    """

    def __init__(
        self, address: str, interpreter: str = sys.executable, *, realtime: bool = False
    ) -> None:
        command = [interpreter, '-m', 'mixtac_slip_control.arm.libfranka_loop', address]
        self._process = subprocess.Popen(
            command + ['--realtime'] * realtime,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            bufsize=0,
            pipesize=PIPE_BYTES,
            env={**os.environ, 'PYTHONPATH': os.pathsep.join(PACKAGES)},
        )
        if self._process.stdin is not None:
            os.set_blocking(self._process.stdin.fileno(), False)
        self._latest: bytes | None = None
        self._late = 0
        self._words = ''
        self._threads = [
            threading.Thread(target=self._read_states, name='franka states', daemon=True),
            threading.Thread(target=self._read_words, name='franka words', daemon=True),
        ]
        for thread in self._threads:
            thread.start()
        self._wait_until_ready()

    def state(self) -> ArmState | None:
        """Return the latest state, or None before the first.

        Raises:
            BackendError: The robot or the connection to it reports a fault.
        """
        self._check()
        latest = self._latest
        if latest is None:
            return None
        stamp_ns, late, *values = STATE.unpack(latest)
        if late > self._late:
            self._late = late
            raise BackendError(
                'a trajectory arrived too late to continue the motion; the arm comes to rest',
                remedy='enable again; if it happens again, use a host with less load',
            )
        q, dq, commanded = np.array(values).reshape(3, JOINTS)
        return ArmState(stamp_ns * 1e-9, q, dq, commanded)

    def send(self, trajectory: PlannedTrajectory) -> None:
        """Replace the trajectory being carried out by another, at once.

        Raises:
            BackendError: A fault of the robot or of the connection, or another number of joints.
        """
        self._check()
        if trajectory.q.shape[1] != JOINTS:
            raise BackendError(f'a Franka has {JOINTS} joints, not {trajectory.q.shape[1]}')
        self._write(pack(trajectory))

    def stop(self) -> None:
        """Let the trajectory end, bring the arm to rest and release it."""
        try:
            self._write(STOP)
            self._process.wait(STOP_S)
        except (BackendError, subprocess.TimeoutExpired):
            self._process.kill()
            self._process.wait()
        for thread in self._threads:
            thread.join()
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None:
                stream.close()

    def _wait_until_ready(self) -> None:
        deadline = time.monotonic() + READY_S
        while time.monotonic() < deadline:
            try:
                if self.state() is not None:
                    return
            except BackendError:
                self.stop()
                raise
            time.sleep(0.01)
        self.stop()
        raise BackendError(f'the robot sent no state within {READY_S:g} s')

    def _check(self) -> None:
        status = self._process.poll()
        if status is None:
            return
        self._threads[1].join(1.0)
        reason = self._words.strip() or f'exit status {status}'
        raise BackendError(f'the arm is no longer controlled: {reason}')

    def _write(self, data: bytes) -> None:
        stream = self._process.stdin
        if stream is None:
            raise BackendError('the process that drives the arm has no input')
        try:
            written = stream.write(data)
        except (OSError, ValueError) as error:
            raise BackendError(f'the process that drives the arm has ended: {error}') from error
        if written != len(data):
            # The rest of it must not be read as the next one; without its client the arm stops.
            self._process.kill()
            raise BackendError(
                'the process that drives the arm takes no trajectories',
                remedy='start slip control again, on a host with less load',
            )

    def _read_states(self) -> None:
        stream = self._process.stdout
        pending = b''
        while stream is not None and (data := stream.read(STATE.size * 64)):
            pending += data
            whole = len(pending) // STATE.size * STATE.size
            if whole:
                self._latest = pending[whole - STATE.size : whole]
            pending = pending[whole:]

    def _read_words(self) -> None:
        stream = self._process.stderr
        while stream is not None and (data := stream.read(4096)):
            self._words = (self._words + data.decode(errors='replace'))[-4096:]


def open_libfranka(parameters: SlipControlParameters, arm: SerialArm) -> LibfrankaBackend:
    """Return the backend that the parameters describe, connected to its arm.

    Raises:
        BackendError: An arm of another number of joints, no address, or what `LibfrankaBackend`
            raises.
    """
    if arm.dof != JOINTS:
        raise BackendError(f'a Franka arm has {JOINTS} joints, the arm of the parameters {arm.dof}')
    if not parameters.arm_address:
        raise BackendError(
            'the libfranka backend has no address', remedy='set arm_address, for example 172.16.0.2'
        )
    interpreter = parameters.arm_python or sys.executable
    return LibfrankaBackend(parameters.arm_address, interpreter, realtime=parameters.arm_realtime)
