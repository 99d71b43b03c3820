# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The virtual sensor in real time: simulation, virtual camera and reference force side by side.

The simulation runs a little ahead of the clock, because a frame must be known before its readout
begins. While a scenario plays whose future is known, it runs much further ahead, so that
an impact, which takes longer to compute than it lasts, is ready in time; a patient sensor lets no
time pass before the scenario is known. Camera, truth and reference hand everything over when its
time has come. If the host cannot keep up all the same, simulated time stops for a while, and the
loss is counted. A node simulates in a process of its own.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from threading import Event, Lock, Thread
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from mixtac_node.process import lower_priority
from mixtac_sim import SimulationError
from mixtac_sim.live import touch
from mixtac_sim.live.simulation_process import SimulationProcess
from mixtac_sim.live.touch import LiveProfile
from mixtac_sim.mechanics.indenters import LIVE_INDENTERS, Indenter
from mixtac_sim.parameters import TouchParameters
from mixtac_sim.pixels.aps import READOUT_US, RESET_US, ApsSettings
from mixtac_sim.pixels.biases import DEFAULT_REGISTERS, PixelSettings
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.usb.endpoints import serial_number
from mixtac_sim.usb.registers import Module
from mixtac_sim.world.effects import EASY, Preset
from mixtac_sim.world.instruments import InertialUnit, ReferenceSensor, WrenchSamples
from mixtac_sim.world.segments import Profile
from mixtac_sim.world.sensor import SensorOutput, TactileSensor, truth_wrench


class SimulationClock:
    """Simulated time [us] that runs with the host's monotonic clock once started.

    If the host cannot keep up, simulated time stops for a while; that loss is counted.

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


PERIOD_S: Final = 0.001
# A patient sensor wakes its reader half as often: on two cores being woken costs more than reading.
_PATIENT_PERIOD_S: Final = 0.002
_CHUNK_US: Final = 4000
# Little beside any lead; a scenario begins two chunks later at the earliest.
_AHEAD_PERIOD_S: Final = 0.02
# What is computed ahead is kept: frames of 45 s are 200 MB.
_MOST_AHEAD_US: Final = 45_000_000
# Niceness of a patient sensor's releasing thread, of the thread that computes ahead, and of the
# process that simulates a patient sensor.
_PATIENT_NICENESS: Final = 5
_AHEAD_NICENESS: Final = 10
_PROCESS_NICENESS: Final = 15
# A frame is known at the end of the chunk in which its readout has ended.
_FRAME_US: Final = RESET_US + READOUT_US + _CHUNK_US
_MAX_BEHIND_US: Final = 250_000
_MAX_BATCHES: Final = 2048
# What is skipped: whole periods of the truth and of the reference.
_SKIP_US: Final = 10_000
# A patient sensor waits when it is late by more than this, or more bytes than these are not read.
_PATIENCE_US: Final = 20_000
_BACKLOG: Final = 1 << 19
# Who records a scenario still does so for a while after its end.
_AFTERMATH_US: Final = 2_000_000


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
        simulated_us: Progress of the simulation [us, simulated time].
        running: Whether the thread of the sensor is alive.
        ahead_us: How far the simulation is ahead of the clock [us].
        late_us: Delay of the output behind the clock [us].
        overruns: Number of times the host could not keep up and time stopped.
        lost_us: Total time for which it stopped [us].
        behind_us: How far stamps of the camera and the reference lie in the past for that [us]: 0
            where they skip.
        playing: Whether a scenario is under way.
        computing: Whether time stands still until more of a scenario is known.
        streaming: Whether a host reads the camera.
        batches_dropped: Batches of truth or reference that were not fetched in time.
    """

    simulated_us: int
    running: bool
    ahead_us: int
    late_us: int
    overruns: int
    lost_us: int
    behind_us: int
    playing: bool
    computing: bool
    streaming: bool
    batches_dropped: int


class VirtualSensor:
    """Runs the parts in two threads: one keeps up with the clock, one computes ahead.

    Args:
        simulation: The tactile sensor, made with ``profile``.
        profile: Contacts that are played.
        device: The camera, made with ``clock.now_us``.
        reference: The reference force sensor.
        inertial: The camera's inertial unit.
        clock: Simulated time.
        patient: Time stops while the host is behind, so that nothing is lost; otherwise the camera
            drops what is not read in time, as a real one does.
        skips: Where time stopped nevertheless, the clocks of camera and reference skip it, as those
            of a real sensor go on: their stamps lie on the host's clock again, with a gap in the
            data, in which nothing has moved.
    """

    def __init__(
        self,
        simulation: Simulation,
        profile: LiveProfile,
        device: VirtualDavis346,
        reference: ReferenceSensor,
        inertial: InertialUnit,
        clock: SimulationClock,
        *,
        patient: bool = False,
        skips: bool = False,
    ) -> None:
        self._patient, self._skips = patient, skips
        self._skipped_us = 0
        self._waiting = self._resting = False
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
        self._overruns = 0
        self._settings_version = (0, 0)
        self._aps = (0, 0)
        self._biases: dict[int, int] = {}
        self._pixels = PixelSettings()
        # What became known by a simulated time [us]: the truth, and the samples of the reference.
        self._pending: deque[tuple[int, NDArray[Any], WrenchSamples]] = deque()
        self._lock = Lock()
        self._simulating = Lock()
        self._truth: deque[WrenchSamples] = deque()
        self._references: deque[WrenchSamples] = deque()
        self._dropped = 0
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
                and by a patient sensor as far as 45 s, before time goes on; what is played
                meanwhile and new settings of the camera take effect as late. Not with 0.

        Returns:
            When it starts [us, simulated time].
        """
        start_us = self._next_start_us() + lead_us
        self._profile.play(scenario, start_us)
        self._ahead_until_us = start_us + round(scenario.duration_s * 1e6) + _AFTERMATH_US
        self._ahead_us = min(2 * lead_us, _MOST_AHEAD_US)
        if self._patient and lead_us:
            # In many short waits everything would compete for the host at every moment, and all
            # messages would be late.
            self._ahead_us, self._resting = _MOST_AHEAD_US, True
        return start_us

    def commanded_force(self) -> tuple[float, Indenter | None]:
        """Return the force [N] commanded when a scenario would begin now, and of what."""
        return self._profile.force_at(self._next_start_us())

    def commanded_pull(self) -> tuple[float, float]:
        """Return the force across the normal [N] commanded when a scenario would begin now."""
        return self._profile.pull_at(self._next_start_us())

    def _next_start_us(self) -> int:
        return self._simulated_us + 2 * _CHUNK_US

    def time_ns(self) -> int:
        """Return the time up to which everything was handed over; it never runs backwards.

        Returns:
            Host time at the start, plus simulated time since [ns since the Unix epoch].
        """
        return self._clock.start_epoch_ns + 1000 * (self._due_us + self._skipped_us)

    def take_truth(self) -> list[WrenchSamples]:
        """Return the true wrench at 1 kHz since the last call, stamped in host time."""
        return self._take(self._truth)

    def take_reference(self) -> list[WrenchSamples]:
        """Return the samples of the reference sensor since the last call, on its own clock."""
        return self._take(self._references)

    def state(self) -> SensorState:
        """Return figures for diagnostics."""
        end_us = self._profile.end_us()
        return SensorState(
            simulated_us=self._simulated_us,
            running=bool(self._threads) and all(thread.is_alive() for thread in self._threads),
            ahead_us=max(0, self._simulated_us - self._clock.now_us()),
            late_us=max(0, self._clock.now_us() - self._due_us),
            overruns=self._overruns,
            lost_us=self._clock.lost_us,
            behind_us=self._clock.lost_us - self._skipped_us,
            playing=end_us is not None and self._clock.now_us() < end_us,
            computing=self._resting,
            streaming=self.device.streaming,
            batches_dropped=self._dropped,
        )

    def step(self) -> None:
        """Bring simulation, camera, truth and reference up to now."""
        if self._simulating.acquire(blocking=False):
            self._follow_registers()
            self._simulating.release()
        while not (self._patient and self._wait_for_host()):
            now_us = self._clock.now_us()
            # A frame must be known before its readout begins, so all that is handed over stays
            # behind the simulation; if that falls behind, data come late but stamped right.
            known_us = self._known_us()
            if now_us - known_us > _MAX_BEHIND_US:
                self._fall_behind(now_us - known_us, known_us)
                continue
            self._hand_over(min(now_us, known_us))
            if known_us >= now_us:
                return
            with self._simulating:
                if self._known_us() < now_us:
                    self._simulate()

    def _hand_over(self, until_us: int) -> None:
        self._due_us = max(self._due_us, until_us)
        self.device.advance(self._due_us)
        self._release(self._due_us)

    def _fall_behind(self, lost_us: int, known_us: int) -> None:
        self._overruns += 1
        if self._skips:
            # What is known keeps its time.
            self._hand_over(known_us)
            lost_us = -(-lost_us // _SKIP_US) * _SKIP_US
            self.device.skip(lost_us)
            self._skipped_us += lost_us
        self._clock.lose(lost_us)

    def _wait_for_host(self) -> bool:
        behind_us = self._clock.now_us() - self._due_us
        self._resting = self._needs_rest()
        slow = behind_us > _PATIENCE_US or self.device.backlog > _BACKLOG
        waiting = slow or self._resting
        if waiting:
            self._clock.lose(behind_us)
            self._overruns += slow and not self._waiting
        self._waiting = waiting
        return waiting

    def _needs_rest(self) -> bool:
        """Return whether more of a scenario has to be computed ahead before time goes on."""
        if not self._ahead_us or self._simulated_us >= self._ahead_until_us:
            return False
        if self._resting:
            return self._simulated_us < self._due_us + self._ahead_us
        return self._known_us() < self._clock.now_us()

    def _known_us(self) -> int:
        return self._simulated_us - self._aps[0] - _FRAME_US

    def _run(self) -> None:
        if self._patient:
            # What reads the camera goes first on a busy CPU; then this thread is late, and waits.
            lower_priority(_PATIENT_NICENESS)
        period_s = _PATIENT_PERIOD_S if self._patient else PERIOD_S
        deadline = time.monotonic()
        while not self._stop.is_set():
            self.step()
            deadline = max(deadline + period_s, time.monotonic())
            # Not Event.wait, which takes several times as long.
            time.sleep(max(0.0, deadline - time.monotonic()))

    def _compute_ahead(self) -> None:
        lower_priority(_AHEAD_NICENESS)
        while not self._stop.is_set():
            limit_us = min(self._clock.now_us() + self._ahead_us, self._ahead_until_us)
            if self._simulated_us >= limit_us:
                self._stop.wait(_AHEAD_PERIOD_S)
                continue
            with self._simulating:
                self._follow_registers()
                self._simulate()

    def _follow_registers(self) -> None:
        version = self.device.settings_version
        if version == self._settings_version:
            return
        self._settings_version = version
        self._follow_aps()
        biases = {place: self.device.register(Module.BIAS, place) for place in DEFAULT_REGISTERS}
        if biases == self._biases:
            return
        self._biases = biases
        pixels = PixelSettings.from_biases(biases, PixelSettings())
        if pixels != self._pixels:
            self._pixels = pixels
            self._simulation.configure_pixels(pixels)

    def _follow_aps(self) -> None:
        wanted = (self.device.exposure_us, self.device.frame_interval_us)
        if wanted == self._aps:
            return
        self._aps = wanted
        # The camera takes frames as fast as it can when a shorter interval is set.
        exposure_us = max(wanted[0], 1)
        interval_us = max(wanted[1], exposure_us + READOUT_US + RESET_US)
        first_us = self._simulated_us + RESET_US
        self._simulation.configure_aps(ApsSettings(exposure_us, interval_us, first_us))

    def _simulate(self) -> None:
        self._simulated_us += _CHUNK_US
        out = self._simulation.advance(self._simulated_us)
        self._inertial.feel(out.wrench_us, out.wrench)
        readings = self._inertial.readings(self._simulated_us, self.device.imu_interval_us)
        self.device.submit(out.events, out.frames, readings)
        samples = self._reference.process(out.wrench_us, out.wrench)
        self._pending.append((self._simulated_us, out.truth, samples))

    def _release(self, until_us: int) -> None:
        """Hand over the truth and the samples of the reference, chunk by chunk."""
        while self._pending and self._pending[0][0] <= until_us:
            _, truth, samples = self._pending.popleft()
            stamp_ns = self._clock.to_epoch_ns(truth['t_us'].astype(np.int64))
            self._put(self._truth, WrenchSamples(stamp_ns, truth_wrench(truth)))
            stamp_ns = samples.t_ns + (self._clock.start_epoch_ns + 1000 * self._skipped_us)
            self._put(self._references, WrenchSamples(stamp_ns, samples.wrench))

    def _put(self, queue: deque[WrenchSamples], batch: WrenchSamples) -> None:
        with self._lock:
            queue.append(batch)
            if len(queue) > _MAX_BATCHES:
                queue.popleft()
                self._dropped += 1

    def _take(self, queue: deque[WrenchSamples]) -> list[WrenchSamples]:
        with self._lock:
            batches = list(queue)
            queue.clear()
        return batches


LARGEST_N: Final = 20.0
"""Largest force that may be commanded [N]; the layer's model ends about there."""
ENDLESS_S: Final = 86_400.0
"""Duration of a contact that is held until it is released [s]."""


class TouchControl:
    """Carries out requests with the current parameters.

    Args:
        sensor: The live sensor.
    """

    def __init__(self, sensor: VirtualSensor) -> None:
        self._sensor = sensor
        self.gestures: dict[str, Callable[[TouchParameters], str]] = {
            'press': self.press,
            'pull': self.pull,
            'load': self.load,
            'drop': self.drop,
            'vibrate': self.vibrate,
            'slide': self.slide,
            'torsion': self.torsion,
            'release': self.release,
        }

    def press(self, p: TouchParameters) -> str:
        """Press the object on the skin; return a description for the user."""
        self._sensor.play(touch.press(LIVE_INDENTERS[p.object], p.press_force, _hold_s(p)))
        return f'pressing {p.object} with {p.press_force} N {_for(p)}'

    def pull(self, p: TouchParameters) -> str:
        """Press the object and pull it aside; return a description for the user.

        It goes on from a press or pull of the same object.
        """
        tool, angle = LIVE_INDENTERS[p.object], math.radians(p.pull_direction)
        before_n, before = self._sensor.commanded_force()
        same = before == tool
        pull_n = (p.pull_force * math.cos(angle), -p.pull_force * math.sin(angle))
        forces = (before_n if same else 0.0, p.press_force)
        pulls = (self._sensor.commanded_pull() if same else (0.0, 0.0), pull_n)
        self._sensor.play(touch.pull(tool, forces, pulls, _hold_s(p)))
        where = f'towards {p.pull_direction} deg'
        return f'pulling {p.object} by {p.pull_force} N {where} under {p.press_force} N, {_for(p)}'

    def load(self, p: TouchParameters) -> str:
        """Put the object down; return a description for the user.

        Raises:
            SimulationError: The object has no mass.
        """
        self._sensor.play(touch.load(LIVE_INDENTERS[p.object], _hold_s(p)))
        return f'putting {p.object} down {_for(p)}'

    def drop(self, p: TouchParameters) -> str:
        """Drop the object; return a description for the user.

        Raises:
            SimulationError: The object has no mass.
        """
        self._sensor.play(touch.drop(LIVE_INDENTERS[p.object], p.drop_height, _hold_s(p)))
        return f'dropping {p.object} from {p.drop_height} mm'

    def vibrate(self, p: TouchParameters) -> str:
        """Vibrate the object in the skin; return a description for the user.

        Raises:
            SimulationError: It would leave the skin.
        """
        gesture = touch.vibrate(
            LIVE_INDENTERS[p.object],
            p.vibration_depth,
            p.vibration_amplitude,
            p.vibration_frequency,
            _hold_s(p),
        )
        self._sensor.play(gesture)
        return f'vibrating {p.object} at {p.vibration_frequency} Hz {_for(p)}'

    def slide(self, p: TouchParameters) -> str:
        """Press the object and pull it over the skin; return a description for the user."""
        self._press_and_move(p, (p.slide_distance, 0.0, 0.0))
        return f'sliding {p.object} by {p.slide_distance} mm under {p.press_force} N, {_for(p)}'

    def torsion(self, p: TouchParameters) -> str:
        """Press the object and turn it about the normal; return a description for the user."""
        self._press_and_move(p, (0.0, 0.0, math.radians(p.torsion_angle)))
        return f'turning {p.object} by {p.torsion_angle} deg under {p.press_force} N, {_for(p)}'

    def _press_and_move(self, p: TouchParameters, move: tuple[float, float, float]) -> None:
        tool = LIVE_INDENTERS[p.object]
        self._sensor.play(touch.press(tool, p.press_force, _hold_s(p), move))

    def release(self, p: TouchParameters) -> str:
        """Take the object off; return a description for the user."""
        force_n, tool = self._sensor.commanded_force()
        self._sensor.play(touch.release(tool or LIVE_INDENTERS[p.object], force_n))
        return 'released'

    def follow(self, p: TouchParameters, force_n: float) -> None:
        """Press the object with a force [N] until the next command, or until it times out.

        Raises:
            SimulationError: The force is not a number, or out of range.
        """
        if not math.isfinite(force_n) or not 0.0 <= force_n <= LARGEST_N:
            raise SimulationError(f'commanded force {force_n} N: 0 to {LARGEST_N} N are possible')
        wanted = LIVE_INDENTERS[p.object]
        before_n, tool = self._sensor.commanded_force()
        start_n = before_n if tool == wanted else 0.0
        self._sensor.play(touch.follow(wanted, start_n, force_n))


def _hold_s(p: TouchParameters) -> float:
    return p.hold_seconds or ENDLESS_S


def _for(p: TouchParameters) -> str:
    return f'for {p.hold_seconds} s' if p.hold_seconds else 'until released'


def make_virtual_sensor(
    *,
    device_seed: int,
    seed: int,
    skew_ppm: float = 0.0,
    preset: Preset = EASY,
    simulation: Simulation | None = None,
    clock: SimulationClock | None = None,
    process: SimulationProcess | None = None,
    patient: bool = False,
    skips: bool = False,
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
        patient: See `VirtualSensor`.
        skips: See `VirtualSensor`.
    """
    profile, clock = LiveProfile(tuple(LIVE_INDENTERS.values())), clock or SimulationClock()
    if process is not None:
        # What is late costs a patient sensor nothing but time.
        niceness = _PROCESS_NICENESS if patient else 0
        process.begin(device_seed, seed, profile, preset=preset, niceness=niceness)
    return VirtualSensor(
        simulation or process or TactileSensor(device_seed, seed, profile, preset=preset),
        profile,
        VirtualDavis346(serial_number(device_seed), skew_ppm=skew_ppm, clock=clock.now_us),
        ReferenceSensor(seed, preset=preset),
        InertialUnit(device_seed),
        clock,
        patient=patient,
        skips=skips,
    )
