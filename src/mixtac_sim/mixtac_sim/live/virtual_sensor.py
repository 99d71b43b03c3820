# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The virtual sensor in real time: simulation, virtual camera and reference force side by side.

The simulation runs a little ahead of the clock, because a frame must be known before its readout
begins. While a scenario plays, its future is known and the simulation runs further ahead. An
impact, which takes longer to compute than it lasts, is then ready in time. Camera, truth and
reference output all data at their simulated time. Simulated time pauses while the host is behind:
no data are lost, and the lost time is counted.

A node simulates in a process of its own: in one process, the simulation and the threads that feed
USB and topics share an interpreter lock, and together they get no more than one core.
"""

from __future__ import annotations

import atexit
import contextlib
import multiprocessing
import signal
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from threading import Event, Lock, Thread
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from mixtac_core.node.process import lower_priority
from mixtac_sim import SimulationError
from mixtac_sim.mechanics.elastomer import LIVE_INDENTERS, Indenter
from mixtac_sim.pixels.aps import READOUT_US, RESET_US, ApsSettings
from mixtac_sim.pixels.biases import DEFAULT_REGISTERS, PixelSettings
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.usb.endpoints import serial_number
from mixtac_sim.usb.registers import Module
from mixtac_sim.world.effects import EASY, Preset
from mixtac_sim.world.instruments import InertialUnit, ReferenceSensor, WrenchSamples
from mixtac_sim.world.segments import LiveProfile, Profile
from mixtac_sim.world.sensor import SensorOutput, TactileSensor, truth_wrench


class SimulationClock:
    """Simulated time [us] that runs with the host's monotonic clock once started.

    Args:
        monotonic_ns: The host's monotonic clock [ns].
        epoch_ns: The host's clock [ns since the Unix epoch].

    Attributes:
        lost_us: Total time for which it stopped [us].
        start_epoch_ns: Host time at which simulated time was 0 [ns since the Unix epoch]. Clocks of
            simulated devices count from it and stop with simulated time: two of them that did not
            would drift apart by every stall of the host.
    """

    def __init__(
        self,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
        epoch_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._monotonic_ns = monotonic_ns
        self._epoch_ns = epoch_ns
        self._start_ns: int | None = None
        self.start_epoch_ns = epoch_ns()
        self.lost_us = 0

    def start(self) -> None:
        """Start time at 0; before it is 0."""
        self.start_epoch_ns = self._epoch_ns()
        self._start_ns = self._monotonic_ns()

    def now_us(self) -> int:
        """Return simulated time now [us]."""
        if self._start_ns is None:
            return 0
        return (self._monotonic_ns() - self._start_ns) // 1000 - self.lost_us

    def lose(self, lost_us: int) -> None:
        """Delay simulated time by ``lost_us`` [us]."""
        self.lost_us += lost_us

    def to_epoch_ns(self, t_us: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert simulated times [us, int64] to host time [ns since the Unix epoch, int64]."""
        return np.asarray(self.start_epoch_ns + (t_us + self.lost_us) * 1000, np.int64)


PERIOD_S: Final = 0.002
"""Period in which data are output [s]: on two cores, waking the reader more often costs more
than reading."""
CHUNK_US: Final = 4000
"""Simulated time of one call of the simulation [us]."""
AHEAD_PERIOD_S: Final = 0.02
"""Pause of the thread that computes ahead [s]: little beside any lead."""
MOST_AHEAD_US: Final = 45_000_000
"""Largest lead of the simulation [us]: frames of 45 s are 200 MB."""
KNOWN_AFTER_US: Final = RESET_US + READOUT_US + CHUNK_US
"""A frame is known at the end of the chunk in which its readout has ended [us]."""
MOST_BEHIND_US: Final = 20_000
"""Time by which the output may be late before simulated time stops [us]."""
MOST_UNREAD: Final = 1 << 19
"""Bytes that the host may leave unread before simulated time stops."""
AFTERMATH_US: Final = 2_000_000
"""Time after a scenario that is computed ahead, too: who records it still does so [us]."""
MOST_BATCHES: Final = 2048
"""Batches of truth or reference that wait to be fetched."""
RELEASE_NICENESS: Final = 5
"""Niceness of the thread that keeps up with the clock: the reader of the camera goes first."""
AHEAD_NICENESS: Final = 10
"""Niceness of the thread that computes ahead and of the process that simulates: when they are late,
it costs nothing but time."""


class Simulation(Protocol):
    """A simulation that a virtual sensor runs: a tactile sensor, or a grasp."""

    def advance(self, until_us: int) -> SensorOutput:
        """Simulate up to a time [us]."""

    def configure_aps(self, settings: ApsSettings) -> None:
        """Change the settings of the next frames."""

    def configure_pixels(self, nominal: PixelSettings) -> None:
        """Change the event pixels, as new biases would."""


@dataclass(frozen=True, slots=True)
class SensorState:
    """Figures for diagnostics.

    Attributes:
        running: Whether the threads of the sensor are alive.
        lost_us: Total time for which simulated time stopped because the host could not keep up
            [us]: stamps of the camera and the reference lie as far in the past.
        playing: Whether a scenario is under way.
        streaming: Whether a host reads the camera.
    """

    running: bool
    lost_us: int
    playing: bool
    streaming: bool


class VirtualSensor:
    """Runs the parts in two threads: one keeps up with the clock, one computes ahead.

    Args:
        simulation: The tactile sensor, made with ``profile``.
        profile: Contacts that are played.
        device: The camera, made with ``clock.now_us``.
        reference: The reference force sensor.
        inertial: The camera's inertial unit.
        clock: Simulated time.
    """

    def __init__(
        self,
        simulation: Simulation,
        profile: LiveProfile,
        device: VirtualDavis346,
        reference: ReferenceSensor,
        inertial: InertialUnit,
        clock: SimulationClock,
    ) -> None:
        self._simulation = simulation
        self._profile = profile
        self.device = device
        self._reference = reference
        self._inertial = inertial
        self._clock = clock
        self._simulated_us = 0
        self._due_us = 0
        self._ahead_us = 0
        self._ahead_until_us = 0
        self._settings_version = 0
        self._aps = (0, 0)
        self._pixels = PixelSettings()
        # Truth and samples of the reference that are known up to a simulated time [us].
        self._pending: deque[tuple[int, NDArray[Any], WrenchSamples]] = deque()
        self._simulating = Lock()
        self._truth: deque[WrenchSamples] = deque(maxlen=MOST_BATCHES)
        self._references: deque[WrenchSamples] = deque(maxlen=MOST_BATCHES)
        self._forces: deque[tuple[int, float]] = deque([(0, 0.0)], maxlen=MOST_BATCHES)
        self._stop = Event()
        self._threads: list[Thread] = []

    def start(self) -> None:
        """Prepare the first moments (which compiles), then let time run in threads."""
        self.step()
        self._clock.start()
        for name, run in (('virtual-sensor', self._run), ('compute-ahead', self._compute_ahead)):
            self._threads.append(Thread(target=run, name=name, daemon=True))
            self._threads[-1].start()

    def close(self) -> None:
        """Stop time and unplug the camera."""
        self._stop.set()
        for thread in self._threads:
            thread.join(5.0)
        self.device.unplug()

    def play(self, scenario: Profile, *, lead_us: int = 0) -> int:
        """Play a scenario as soon as possible; it replaces one that is playing.

        Args:
            scenario: The scenario.
            lead_us: Time by which it starts later [us]. It is computed up to twice as far ahead,
                45 s at most; what is played meanwhile and new settings of the camera take effect
                as late. Not with 0.

        Returns:
            When it starts [us, simulated time].
        """
        start_us = self._next_start_us() + lead_us
        self._profile.play(scenario, start_us)
        self._ahead_until_us = start_us + round(scenario.duration_s * 1e6) + AFTERMATH_US
        self._ahead_us = min(2 * lead_us, MOST_AHEAD_US)
        return start_us

    def commanded_force(self) -> tuple[float, Indenter | None]:
        """Return the force [N] commanded when a scenario would begin now, and of what."""
        return self._profile.force_at(self._next_start_us())

    def commanded_pull(self) -> tuple[float, float]:
        """Return the force across the normal [N] commanded when a scenario would begin now."""
        return self._profile.pull_at(self._next_start_us())

    def _next_start_us(self) -> int:
        return self._simulated_us + 2 * CHUNK_US

    def time_ns(self) -> int:
        """Return the time up to which all data were output; it never runs backwards.

        Returns:
            Host time at the start, plus simulated time since [ns since the Unix epoch].
        """
        return self._clock.start_epoch_ns + 1000 * self._due_us

    def take_truth(self) -> list[WrenchSamples]:
        """Return the true wrench at 1 kHz since the last call, stamped in host time."""
        return [self._truth.popleft() for _ in range(len(self._truth))]

    def take_reference(self) -> list[WrenchSamples]:
        """Return the samples of the reference sensor since the last call, on its own clock."""
        return [self._references.popleft() for _ in range(len(self._references))]

    def true_force(self, stamp_us: int) -> float:
        """Return the true normal force [N] at a stamp of the last seconds [us, camera clock]."""
        return float(np.interp(stamp_us, *np.transpose(self._forces.copy())))

    def state(self) -> SensorState:
        """Return figures for diagnostics."""
        end_us = self._profile.end_us()
        return SensorState(
            running=bool(self._threads) and all(thread.is_alive() for thread in self._threads),
            lost_us=self._clock.lost_us,
            playing=end_us is not None and self._clock.now_us() < end_us,
            streaming=self.device.streaming,
        )

    def step(self) -> None:
        """Bring simulation, camera, truth and reference up to now, unless the host is behind."""
        if self._simulating.acquire(blocking=False):
            self._follow_registers()
            self._simulating.release()
        while not self._wait_for_host():
            now_us = self._clock.now_us()
            # A frame must be known before its readout begins, so all that is handed over stays
            # behind the simulation.
            known_us = self._known_us()
            self._due_us = max(self._due_us, min(now_us, known_us))
            self.device.advance(self._due_us)
            self._release()
            if known_us >= now_us:
                return
            with self._simulating:
                if self._known_us() < now_us:
                    self._simulate()

    def _wait_for_host(self) -> bool:
        """Return whether simulated time stops now because the host is behind."""
        behind_us = self._clock.now_us() - self._due_us
        late = behind_us > MOST_BEHIND_US or self.device.backlog > MOST_UNREAD
        if late:
            self._clock.lose(behind_us)
        return late

    def _known_us(self) -> int:
        return self._simulated_us - self._aps[0] - KNOWN_AFTER_US

    def _run(self) -> None:
        lower_priority(RELEASE_NICENESS)
        deadline = time.monotonic()
        while not self._stop.is_set():
            self.step()
            deadline = max(deadline + PERIOD_S, time.monotonic())
            # Not Event.wait, which takes several times as long.
            time.sleep(max(0.0, deadline - time.monotonic()))

    def _compute_ahead(self) -> None:
        lower_priority(AHEAD_NICENESS)
        while not self._stop.is_set():
            limit_us = min(self._clock.now_us() + self._ahead_us, self._ahead_until_us)
            if self._simulated_us >= limit_us:
                self._stop.wait(AHEAD_PERIOD_S)
                continue
            with self._simulating:
                self._follow_registers()
                self._simulate()

    def _follow_registers(self) -> None:
        version = self.device.settings_version
        if version == self._settings_version:
            return
        self._settings_version = version
        wanted = (self.device.exposure_us, self.device.frame_interval_us)
        if wanted != self._aps:
            self._aps = wanted
            # The camera takes frames as fast as it can when a shorter interval is set.
            exposure_us = max(wanted[0], 1)
            interval_us = max(wanted[1], exposure_us + READOUT_US + RESET_US)
            first_us = self._simulated_us + RESET_US
            self._simulation.configure_aps(ApsSettings(exposure_us, interval_us, first_us))
        biases = {place: self.device.register(Module.BIAS, place) for place in DEFAULT_REGISTERS}
        pixels = PixelSettings.from_biases(biases)
        if pixels != self._pixels:
            self._pixels = pixels
            self._simulation.configure_pixels(pixels)

    def _simulate(self) -> None:
        self._simulated_us += CHUNK_US
        out = self._simulation.advance(self._simulated_us)
        self._inertial.feel(out.wrench_us, out.wrench)
        readings = self._inertial.readings(self._simulated_us, self.device.imu_interval_us)
        self.device.submit(out.events, out.frames, readings)
        samples = self._reference.process(out.wrench_us, out.wrench)
        self._pending.append((self._simulated_us, out.truth, samples))

    def _release(self) -> None:
        """Output the truth and the samples of the reference that are due, chunk by chunk."""
        while self._pending and self._pending[0][0] <= self._due_us:
            _, truth, samples = self._pending.popleft()
            for row in truth[-1:]:
                self._forces.append((self.device.stamp_us(int(row['t_us'])), row['fz']))
            stamp_ns = self._clock.to_epoch_ns(truth['t_us'].astype(np.int64))
            self._truth.append(WrenchSamples(stamp_ns, truth_wrench(truth)))
            stamp_ns = samples.t_ns + self._clock.start_epoch_ns
            self._references.append(WrenchSamples(stamp_ns, samples.wrench))


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
        # At the end of this process, multiprocessing sends SIGTERM, and waits.
        atexit.register(self._process.kill)
        theirs.close()
        self._profile = LiveProfile()
        self._plays = self._profile.plays
        # Calls of the sensor that go with the next request.
        self._calls: list[tuple[str, Any]] = []

    def begin(
        self, device_seed: int, trial_seed: int, profile: LiveProfile, *, preset: Preset
    ) -> None:
        """Make the sensor.

        Args:
            device_seed: See `TactileSensor`.
            trial_seed: See `TactileSensor`.
            profile: Contacts that are played; those of the sensor follow them.
            preset: See `TactileSensor`.
        """
        self._profile = profile
        self._pipe.send((device_seed, trial_seed, profile.indenters, preset))

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
        plays, self._plays = self._plays, self._profile.plays
        changed = None if plays is self._plays else self._plays
        calls, self._calls = self._calls, []
        try:
            self._pipe.send((changed, calls, until_us))
            out: SensorOutput = self._pipe.recv()
        except (EOFError, OSError) as error:
            raise SimulationError('the process of the simulation has ended') from error
        return out


def _serve(pipe: Connection, theirs: Connection) -> None:
    """Simulate on request until the other process ends."""
    theirs.close()
    # These come to the whole group of processes; the other end of the pipe decides.
    signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    with contextlib.suppress(EOFError, OSError):
        device_seed, trial_seed, indenters, preset = pipe.recv()
        profile = LiveProfile(indenters)
        sensor = TactileSensor(device_seed, trial_seed, profile, preset=preset)
        while True:
            plays, calls, until_us = pipe.recv()
            if plays is not None:
                profile.plays = plays
            for name, settings in calls:
                getattr(sensor, name)(settings)
            pipe.send(sensor.advance(until_us))
            # Not before: whoever starts a sensor waits for its first moments, which compile.
            lower_priority(AHEAD_NICENESS)


def make_virtual_sensor(
    *,
    device_seed: int,
    seed: int,
    skew_ppm: float = 0.0,
    preset: Preset = EASY,
    simulation: Simulation | None = None,
    clock: SimulationClock | None = None,
    process: SimulationProcess | None = None,
) -> VirtualSensor:
    """Return a virtual sensor that nothing touches yet; `VirtualSensor.start` lets it run.

    Args:
        device_seed: Seed of the sensor: beads, stiffness, lamp, pixels, serial number of the
            camera.
        seed: Seed of the trial: contact point, noise, drifts, clock of the reference sensor.
        skew_ppm: Rate of the camera's clock over the host's, less one [ppm].
        preset: Difficulty of the sensor.
        simulation: Simulation to run instead of a tactile sensor.
        clock: Simulated time; by default that of the host.
        process: Where to simulate the tactile sensor; by default in this process.
    """
    profile, clock = LiveProfile(tuple(LIVE_INDENTERS.values())), clock or SimulationClock()
    if process is not None:
        process.begin(device_seed, seed, profile, preset=preset)
    return VirtualSensor(
        simulation or process or TactileSensor(device_seed, seed, profile, preset=preset),
        profile,
        VirtualDavis346(serial_number(device_seed), skew_ppm=skew_ppm, clock=clock.now_us),
        ReferenceSensor(seed, preset=preset),
        InertialUnit(device_seed),
        clock,
    )
