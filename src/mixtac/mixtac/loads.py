# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Plateaus of known loads, from a recording or on a live sensor, for `mixtac calibrate-force`.

`mixtac_fger.force_calibration` defines plateaus, and rejects those that cannot be used.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from mixtac_core.node.process import GraphError
from mixtac_fger.estimator import open_estimator
from mixtac_fger.force_calibration import (
    PRESS,
    PULL,
    ForceCalibrationError,
    Kind,
    Load,
    Plateau,
    Stretch,
    find_plateaus,
    last_contact,
    plateau_of,
    reference_loads,
    steady_stretches,
    unsteady,
)
from mixtac_fger.streaming import ForceEstimator
from mixtac_fger.validity import Reason
from mixtac_fger.weights import Model

if TYPE_CHECKING:
    from mixtac.monitor_node import Monitor
    from mixtac_core.recordings.camera_stream import Recording

F64 = NDArray[np.float64]
T = TypeVar('T')


@dataclass
class Session:
    """Measurements of a calibration.

    Attributes:
        loads: Known loads.
        pull_loads: Known sideways loads.
        plateaus: Plateau of each load.
        pulls: Plateau of each sideways load.
        serial: Serial number of the camera, empty while unknown.
        by_reference: Whether a reference sensor has measured the loads.
    """

    loads: Sequence[Load]
    pull_loads: Sequence[Load]
    plateaus: list[Plateau] = field(default_factory=list)
    pulls: list[Plateau] = field(default_factory=list)
    serial: str = ''
    by_reference: bool = False

    def measure(self, t_s: F64, reference_n: F64) -> None:
        """Measure the loads by a reference sensor.

        Args:
            t_s: Times on the clock of the plateaus [s].
            reference_n: Its normal force and its forces along x and y [N], [T, 3].
        """
        self.by_reference = True
        self.loads = reference_loads(t_s, reference_n[:, :1], self.plateaus)
        self.pull_loads = reference_loads(t_s, reference_n[:, 1:], self.pulls)


def from_bag(
    path: Path, model: Model, loads: Sequence[Load], pulls: Sequence[Load], reference: str
) -> Session:
    """Return the plateaus of a recording of the procedure.

    Args:
        path: Bag or AEDAT4 file that begins and ends without a load.
        model: Model that estimates its forces.
        loads: Loads in order of application.
        pulls: Sideways loads in order, all in the last contact; empty for none.
        reference: Topic of a reference force to use instead if the bag has it; empty for none.

    Raises:
        MixtacError: The recording cannot be read, or does not allow a calibration.
    """
    from mixtac_core.recordings.camera_stream import open_recording

    with closing(open_recording(path)) as recording:
        t_us, forces = estimated(recording, model)
    if not len(t_us):
        raise ForceCalibrationError(
            f'{path} gives no force: it begins in contact, or has no frames',
            'contact',
            'record events and frames, and begin with a second without a load',
        )
    t_s, force_n = 1e-6 * (t_us - t_us[0]), forces[:, 0]
    session, measured = Session(loads, pulls), None
    if path.is_dir() or path.suffix in {'.mcap', '.db3'}:
        session.serial, measured = _bag_facts(path, recording, int(t_us[0]), reference)
    last = len(t_s)
    if pulls:
        last, contact = last_contact(t_s, force_n)
        aside = forces[contact, 1] + 1j * forces[contact, 2]
        session.pulls = find_plateaus(t_s[contact], aside, len(pulls), PULL)
    count = len(loads) if measured is None else None
    session.plateaus = find_plateaus(t_s[:last], force_n[:last], count)
    if measured is not None:
        session.measure(*measured)
    return session


UNUSABLE: Final = {Reason.ZERO_UNKNOWN, Reason.OTHER_CAMERA, Reason.FRAME_FROZEN, Reason.STALE}
"""Estimates with one of these reasons do not show the force of their moment. All others are used:
loads that disagree, or a zero that does not return, reveal a wrong one."""


def estimated(recording: Recording, model: Model) -> tuple[NDArray[np.int64], F64]:
    """Return window ends [us, recorded camera clock] and the estimates of a recording.

    Estimates are the normal force, and that along x and y, NaN where it is unknown [N], [T, 3].
    """
    from mixtac_core.recordings.messages import left_aligned

    # A recording for a calibration begins without a load.
    estimator = ForceEstimator(open_estimator(model), assume_free=True)
    rows: list[tuple[float, ...]] = []
    for piece in recording.pieces():
        for frame in piece.frames:
            image = left_aligned(np.minimum(frame.image, np.uint16(1023)))
            estimator.push_frame(image, frame.middle_us)
        if piece.advances:
            for each in estimator.push_events(piece.events, piece.until_us):
                if each.reason not in UNUSABLE:
                    x, y = (np.nan, np.nan) if each.shear is None else each.shear[:2]
                    rows.append((each.end_us, each.force, x, y))
    table = np.array(rows, np.float64).reshape(-1, 4)
    return table[:, 0].astype(np.int64), table[:, 1:]


def _bag_facts(
    path: Path, recording: Recording, start_us: int, reference: str
) -> tuple[str, tuple[F64, F64] | None]:
    """Return the serial number of the camera, and times [s] and forces [N] of any reference.

    The forces are the normal force and the forces along x and y, [T, 3].
    """
    from mixtac_core.node.topics import CAMERA_CLOCK, normal_force, sideways_force
    from mixtac_core.recordings.bag import BagFile

    with BagFile(path) as bag:
        clocks = bag.topics(CAMERA_CLOCK.type_name)
        serial = next(bag.messages(clocks[0]))[2].source if clocks else ''
        if not reference or not bag.counts.get(reference):
            return serial, None
        _, leader = recording.info.contents[0]
        _, received_ns, _ = next(bag.messages(leader))
        # Plateaus last seconds: the first packet's delay and the clocks' drift do not matter.
        begin_ns = received_ns + 1000 * (start_us - recording.info.start_us)
        rows = [
            (ns - begin_ns, normal_force(m), *sideways_force(m))
            for _, ns, m in bag.messages(reference)
        ]
    table = np.array(rows, np.float64)
    return serial, (1e-9 * table[:, 0], table[:, 1:])


HOLD_S: Final = 1.2
"""Shortest plateau on a live sensor [s]."""
STILL_N: Final = 0.04
"""Largest standard deviation of a sensor that nobody touches [N]."""
RECENT_S: Final = 6.0
"""Forces before this time are not used [s]: the load was still being put on."""
PATIENCE_S: Final = 60.0
"""Longest time for each step [s]: of sensor time, and of host time without a force."""
POLL_S: Final = 0.1
"""Time between two looks at the forces [s]."""


class LiveProcedure:
    """Leads through the loads on a running sensor.

    Args:
        console: Where to prompt.
        monitor: Listens to the sensor.
        yes: Do not wait for the Enter key.
        drives: Whether the sensor is virtual and operated by this procedure.
    """

    def __init__(
        self, console: Console, monitor: Monitor, *, yes: bool = True, drives: bool = False
    ) -> None:
        self._console, self._monitor, self._yes, self._drives = console, monitor, yes, drives
        self._begin = 0

    def lead(
        self, loads: Sequence[Load], pulls: Sequence[Load], prompt: str = 'Put {:g} g on'
    ) -> Session:
        """Prompt for one load after the other, and return their plateaus.

        Args:
            loads: Loads to ask for.
            pulls: Sideways loads to ask for afterwards, under the largest of the loads.
            prompt: How to ask for a load, with a place for its grams.

        Raises:
            ForceCalibrationError: The measured loads do not allow a calibration.
            GraphError: A node failed.
        """
        session = Session(loads, pulls)
        rest = self._tare()
        for load in loads:
            self._ask(prompt.format(load.grams), 'press', force=load.force_n)
            under = self._under(load, rest, PRESS)
            self._ask('Take it off', 'release')
            session.plateaus.append(self._full(under, PRESS))
            rest = session.plateaus[-1].rests[-1]
        if pulls:
            press = max(loads, key=lambda load: load.force_n)
            # A contact that a pull holds at nothing is free to move aside.
            pull = {'force': press.force_n, 'pull_direction': 0.0}
            self._ask(prompt.format(press.grams), 'pull', **pull, pull=0.0)
            self._under(press, rest, PRESS)
            rest = self._wait('rest', PULL, lambda stretch: stretch)
            for load in pulls:
                self._ask(f'Pull it aside with {load.grams:g} g', 'pull', **pull, pull=load.force_n)
                under = self._under(load, rest, PULL)
                self._ask('Take only the mass off its string', 'pull', **pull, pull=0.0)
                session.pulls.append(self._full(under, PULL))
                rest = session.pulls[-1].rests[-1]
            self._ask('Take everything off', 'release')
        session.serial = self._monitor.serial
        return session

    def reference(self) -> tuple[F64, F64]:
        """Return times of the reference on the clock of the estimate [s], and its forces [N]."""
        (arrival_ns, stamps_ns), _ = self._monitor.estimate.samples()
        (times_ns, _), force_n = self._monitor.measured.samples()
        # What arrived together belongs together.
        at_ns = np.interp(
            times_ns - arrival_ns[0], arrival_ns - arrival_ns[0], stamps_ns - stamps_ns[0]
        )
        return 1e-9 * at_ns, force_n

    def _tare(self) -> Stretch:
        def still(stretch: Stretch) -> Stretch | None:
            return stretch if stretch.sd_n < STILL_N else None

        def tare(stretch: Stretch) -> Stretch | None:
            if found := still(stretch):
                # Refused while a host that is too slow has no estimate: tried again.
                self._monitor.trigger('fger/tare')
            return found

        self._console.print('Take everything off the gel and leave the sensor alone.')
        if not self._yes:
            try:
                self._console.input('Press Enter when it is free ...')
            except EOFError as error:
                raise GraphError('no terminal to read Enter from', remedy='give --yes') from error
        self._wait('still and free', PRESS, tare)
        # The estimate starts over: earlier forces belong to another zero.
        self._begin = self._count()
        return self._wait('zero', PRESS, still)

    def _ask(self, prompt: str, gesture: str, **settings: float) -> None:
        """Ask for a load, or apply it to a virtual sensor that is operated."""
        self._console.print(f'{prompt}, and keep still.')
        if self._drives:
            self._monitor.touch(gesture, hold=0.0, **settings)

    def _under(self, load: Load, rest: Stretch, kind: Kind) -> Plateau:
        """Return the plateau of a load, relative to the rest before it."""

        def plateau(stretch: Stretch) -> Plateau | None:
            found = plateau_of(stretch, rest, None, kind)
            return found if stretch.seconds >= HOLD_S else None

        found = self._wait(f'{load.grams:g} g', kind, plateau)
        self._console.print(f'  {load.grams:g} g: estimate {found.size_n:.3f} N')
        return found

    def _full(self, under: Plateau, kind: Kind) -> Plateau:
        """Return a plateau relative to the rests before and after it, once the load is off."""
        (rest,) = under.rests
        return self._wait('rest', kind, lambda after: plateau_of(under.span, rest, after, kind))

    def _wait(self, what: str, kind: Kind, find: Callable[[Stretch], T | None]) -> T:
        """Wait until `find` accepts a steady stretch from now on, and show the force meanwhile.

        Raises:
            ForceCalibrationError: No stretch was accepted in time.
            GraphError: A node ended or refuses, or no force arrives for `PATIENCE_S`.
        """
        first = seen = self._count()
        heard_s = time.monotonic()
        with self._console.status(what) as status:
            while True:
                time.sleep(POLL_S)
                self._monitor.processes.check()
                count = self._count()
                if count > seen:
                    heard_s, seen = time.monotonic(), count
                elif time.monotonic() - heard_s > PATIENCE_S:
                    raise GraphError(f'no force for {PATIENCE_S:.0f} s while waiting for {what}')
                if seen - first < 2:
                    continue
                t_s, series = (each[first - self._begin :] for each in self._series(kind))
                recent = t_s > t_s[-1] - RECENT_S
                refused = None
                for stretch in steady_stretches(t_s[recent], series[recent]):
                    try:
                        if (found := find(stretch)) is not None:
                            return found
                    except (ForceCalibrationError, GraphError) as error:
                        refused = error
                left_s = PATIENCE_S - (t_s[-1] - t_s[0])
                status.update(f'{what}: {series[-50:].mean():.3f} N, {left_s:3.0f} s left')
                if left_s < 0.0:
                    raise refused or unsteady(t_s, series, (), kind)

    def _count(self) -> int:
        return len(self._monitor.estimate.samples()[1])

    def _series(self, kind: Kind) -> tuple[F64, NDArray[Any]]:
        """Return times [s, sensor time] and forces [N] since the sensor was tared."""
        (_, stamps_ns), force_n = self._monitor.estimate.samples()
        series = force_n[:, 0] if kind is PRESS else force_n[:, 1] + 1j * force_n[:, 2]
        return 1e-9 * (stamps_ns[self._begin :] - stamps_ns[0]), series[self._begin :]
