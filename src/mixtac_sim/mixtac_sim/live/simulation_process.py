# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A tactile sensor that is simulated in a process of its own.

In one process, the simulation and the threads that feed USB and topics share an interpreter lock:
each waits for the other, and together they get no more than one core.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from mixtac_sim import SimulationError
from mixtac_sim.live.touch import LiveProfile
from mixtac_sim.pixels.aps import ApsSettings
from mixtac_sim.pixels.biases import PixelSettings
from mixtac_sim.world.effects import Preset
from mixtac_sim.world.sensor import SensorOutput, TactileSensor


class SimulationProcess:
    """Simulates what a `TactileSensor` does, in a process that ends with this one.

    The process is forked: make it before this process starts threads, and `begin` when the sensor
    is known.
    """

    def __init__(self) -> None:
        context = multiprocessing.get_context('fork')
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(theirs, self._pipe), name='simulation', daemon=True
        )
        self._process.start()
        theirs.close()
        self._profile = LiveProfile()
        # Calls of the sensor that go with the next request.
        self._calls: list[tuple[str, Any]] = []

    def begin(
        self,
        device_seed: int,
        trial_seed: int,
        profile: LiveProfile,
        *,
        preset: Preset,
        niceness: int = 0,
    ) -> None:
        """Make the sensor.

        Args:
            device_seed: See `TactileSensor`.
            trial_seed: See `TactileSensor`.
            profile: What is played on it there is played on the sensor.
            preset: See `TactileSensor`.
            niceness: Niceness of the process.
        """
        self._profile = profile
        self._pipe.send((device_seed, trial_seed, profile.indenters, preset, niceness))

    def configure_aps(self, settings: ApsSettings) -> None:
        """Change the settings of the next frames; see `TactileSensor`."""
        self._calls.append(('configure_aps', settings))

    def configure_pixels(self, nominal: PixelSettings) -> None:
        """Change the event pixels; see `TactileSensor`."""
        self._calls.append(('configure_pixels', nominal))

    def advance(self, until_us: int) -> SensorOutput:
        """Return what happened from the last call's time to before ``until_us`` [us].

        Raises:
            SimulationError: The process has ended.
        """
        plays = self._profile.changes(until_us)
        calls, self._calls = self._calls, []
        try:
            self._pipe.send((plays, calls, until_us))
            out: SensorOutput = self._pipe.recv()
        except (EOFError, OSError) as error:
            raise SimulationError('the process of the simulation has ended') from error
        return out


def _serve(pipe: Connection, theirs: Connection) -> None:
    """Simulate on request until the other process ends."""
    theirs.close()
    # It comes to the whole group of processes; the other end of the pipe decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(EOFError, OSError):
        device_seed, trial_seed, indenters, preset, niceness = pipe.recv()
        if niceness:
            os.nice(niceness)
            # Linux may share its time among sessions first, and heeds niceness only within each.
            os.setsid()
            with contextlib.suppress(OSError):
                Path('/proc/self/autogroup').write_text(str(niceness), encoding='ascii')
        profile = LiveProfile(indenters)
        sensor = TactileSensor(device_seed, trial_seed, profile, preset=preset)
        while True:
            plays, calls, until_us = pipe.recv()
            if plays is not None:
                profile.replace(plays)
            for name, settings in calls:
                getattr(sensor, name)(settings)
            pipe.send(sensor.advance(until_us))
