# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The procedure of `mixtac calibrate-force` on a live sensor.

It prompts for one load after the other and finds the plateau of each by itself. What a plateau is,
and what is refused, is in `mixtac_fger.force_calibration`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console

from mixtac_cli.calibrate_force.session import F64, Session, Sideways
from mixtac_cli.monitor_node import Monitor
from mixtac_cli.up import start_nodes
from mixtac_fger.force_calibration import (
    CONTACT_N,
    SHORTEST_S,
    ForceCalibrationError,
    Load,
    Stretch,
    fit_gain,
    next_load_tells,
    plateau_of,
    reference_loads,
    steady_together,
    unsteady,
    zero_lost,
)
from mixtac_fger.pull_calibration import (
    LEAST_PULL_N,
    SLID_PART,
    WAYS,
    Both,
    mean_of,
    measured,
    no_pull,
    pull_of,
    slid,
)
from mixtac_node.graph import is_virtual, sensor_graph
from mixtac_node.process import GraphError, ProcessGroup

WORDS = {'+x': 'to the right', '-x': 'to the left', '+y': 'upwards', '-y': 'downwards'}
HOLD_S = 1.2
"""Length of a live plateau [s]."""
RECENT_S = 6.0
"""What happened earlier under a load is not used [s]: it was still being put on."""
PATIENCE_S = 60.0
"""Time for each step [s, sensor time]."""
SILENCE_S = 60.0
"""Time without a force after which the sensor counts as dead [s]."""
SESSION_S = 1200.0
POLL_S = 0.1


class LiveProcedure:
    """Leads through the procedure on a running sensor.

    Args:
        console: Where to prompt.
        namespace: ROS namespace of the sensor.
        device: As for `mixtac up`.
        scale: A kitchen scale shows the load.
        yes: Do not wait for the Enter key; operate the virtual sensor.
        fewest: Loads after which the gain is fitted.
    """

    def __init__(
        self,
        console: Console,
        namespace: str,
        device: str,
        *,
        scale: bool = False,
        yes: bool = False,
        fewest: int = 2,
    ) -> None:
        self._console, self._namespace, self._device = console, namespace, device
        self._scale, self._yes, self._fewest = scale, yes, fewest
        self._drives = yes and is_virtual(device)
        self._begin = 0
        self._session = Session()

    def run(
        self,
        model: Path,
        loads: Sequence[Load],
        params_file: Path | None,
        *,
        known: bool,
        pulls: Sequence[Sideways] = (),
    ) -> Session:
        """Start the sensor, lead through the loads, stop the sensor.

        Args:
            model: Weight file of the estimator.
            loads: Loads to ask for.
            params_file: Parameter file of the nodes.
            known: Take these loads even where a reference sensor measures them.
            pulls: Loads to the side to ask for afterwards, under the largest of the others.

        Raises:
            ForceCalibrationError: The sensor cannot be calibrated by what was seen.
            GraphError: A node failed.
        """
        # It asks for an untouched sensor before it starts one.
        estimator = {
            'model': str(model.resolve()),
            'assume_free': True,
            # Whatever the parameter file says: what is measured is the model.
            'force_scale': 1.0,
            'sideways_scale': 1.0,
            'invalid_force': 'withhold',
            'tare_on_release': False,
        }
        nodes = sensor_graph(self._device, estimator=estimator)
        self._console.print('starting the sensor; a first start compiles for some minutes')
        with ProcessGroup() as processes, Monitor(self._namespace, SESSION_S) as monitor:
            start_nodes(processes, nodes, self._namespace, params_file, 'warn')
            monitor.bring_up_all(nodes, processes)
            monitor.listen()
            monitor.wait_for_force(processes.check)
            return self.lead(processes, monitor, loads, known=known, pulls=pulls)

    def lead(
        self,
        processes: ProcessGroup,
        monitor: Monitor,
        loads: Sequence[Load],
        *,
        known: bool,
        pulls: Sequence[Sideways] = (),
    ) -> Session:
        """Lead through the loads on a sensor that gives forces.

        Args:
            processes: Its nodes.
            monitor: Listens to it.
            loads: Loads to ask for.
            known: Take these loads even where a reference sensor measures them.
            pulls: Loads to the side to ask for afterwards, under the largest of the others.

        Raises:
            ForceCalibrationError: The sensor cannot be calibrated by what was seen.
            GraphError: A node failed.
        """
        self._processes, self._monitor = processes, monitor
        zero = self._tare()
        by_reference = not known and monitor.reference_count > 0
        if by_reference:
            self._session.known_by = 'reference'
            self._console.print('the reference sensor measures the loads')
        self._put_all(zero, loads, by_reference=by_reference)
        if pulls:
            press = max(loads, key=lambda load: load.force_n)
            self._pull_all(press, pulls, by_reference=by_reference)
        t_s, forces = self._series()
        self._session.t_s, self._session.force_n = t_s, forces[:, 0]
        self._session.serial = monitor.serial
        return self._session

    def _tare(self) -> Stretch:
        self._console.print('Take everything off the gel and leave the sensor alone.')
        if not self._yes:
            try:
                self._console.input('Press Enter when it is free ...')
            except EOFError as error:
                raise GraphError('there is no Enter key here', remedy='give --yes') from error
        self._wait_steady('still and free', is_still)
        self._monitor.trigger('fger/tare', self._processes.check)
        # The estimate starts over: what was before belongs to another zero.
        self._begin = self._monitor.force_count
        return self._wait_steady('zero', is_still)

    def _put_all(self, zero: Stretch, loads: Sequence[Load], *, by_reference: bool) -> None:
        session = self._session
        session.zeros.append(zero)
        pending: list[tuple[Load, Stretch]] = []
        for index, load in enumerate(loads):
            previous = pending[-1] if pending else None
            pending.append((load, self._put(load, zero, previous)))
            following = loads[index + 1] if index + 1 < len(loads) else None
            if following is not None and following.force_n < load.force_n:
                continue
            after = self._take_off(pending[-1][1])
            for place, (each, stretch) in enumerate(pending):
                session.plateaus.append(plateau_of(stretch, zero, after, unloading=place > 0))
                session.loads.append(each)
            zero, pending = after, []
            session.zeros.append(zero)
            if by_reference:
                session.loads = self._measured()
            if following is None or len({each.force_n for each in session.loads}) < self._fewest:
                continue
            if self._fewest > 1 and not next_load_tells(
                fit_gain(session.loads, session.plateaus), following
            ):
                session.stopped_early = True
                self._console.print('further loads would tell nothing more')
                return

    def _pull_all(self, press: Load, pulls: Sequence[Sideways], *, by_reference: bool) -> None:
        """Lead through the pulls at what presses."""
        pressed = self._put(press, self._session.zeros[-1], None, loose=True)
        refused = [slid('the sideways force is never steady')]
        rest = self._wait_sideways('rest', partial(_is_near, 0j, float('inf')), refused)
        rests, found = [rest], self._session.pulls
        for load, way in pulls:
            pulled = self._pull(press, load, way, rest)
            self._console.print('Take the mass off its thread; leave what presses on the gel.')
            self._touch(press, 0.0, way)
            seen = abs(mean_of(pulled) - mean_of(rest))
            start, most = mean_of(rest), max(LEAST_PULL_N, SLID_PART * seen)
            refused = [slid(f'the pull of {load.grams:.1f} g leaves more than {most:.3f} N behind')]
            after = self._wait_sideways('rest', partial(_is_near, start, most), refused)
            found.append(pull_of(load, WAYS[way], pulled, rest, after))
            rest = after
            rests.append(rest)
        self._take_off(pressed)
        if by_reference:
            t_s, _, across = self._reference()
            found[:] = measured(t_s, across, found, [x for x, _ in rests])

    def _pull(self, press: Load, load: Load, way: str, rest: Both) -> Both:
        """Prompt for a pull and return its plateau."""
        self._console.print(
            f'Pull what presses aside with {load.grams:g} g on a thread, towards {way}'
            f' ({WORDS[way]} in the image), and keep still.'
        )
        self._touch(press, load.force_n, way)
        refused = [slid(f'the force is never steady under the pull of {load.grams:.1f} g')]

        def is_pulled(span: Both) -> bool:
            seen = abs(mean_of(span) - mean_of(rest))
            if span[0].end_s - span[0].start_s < HOLD_S:
                return False
            try:
                if seen < LEAST_PULL_N:
                    raise no_pull(load, seen)
                pull_of(load, WAYS[way], span, rest, None)
            except ForceCalibrationError as error:
                refused[:] = [error]
                return False
            return True

        found = self._wait_sideways(f'{load.grams:g} g {way}', is_pulled, refused)
        seen = mean_of(found) - mean_of(rest)
        self._console.print(
            f'  {load.grams:g} g {way}: estimate {seen.real:+.3f}, {seen.imag:+.3f} N',
            highlight=False,
        )
        return found

    def _touch(self, press: Load, pull_n: float, way: str) -> None:
        """Let the virtual sensor press with a load while a force pulls it aside."""
        if not self._drives:
            return
        direction = float(np.degrees(np.angle(WAYS[way])))
        load = {'force': press.force_n, 'pull': pull_n, 'pull_direction': direction, 'hold': 0.0}
        self._monitor.touch('pull', self._processes.check, **load)

    def _put(
        self,
        load: Load,
        zero: Stretch,
        previous: tuple[Load, Stretch] | None,
        *,
        loose: bool = False,
    ) -> Stretch:
        """Prompt for a load and return its plateau; nothing holds a loose one sideways."""
        grams = load.grams
        less = previous is not None
        if self._scale:
            prompt = f'Press until the scale shows {grams:g} g, and keep still.'
        else:
            way = 'Take weight off until' if less else 'Put'
            prompt = f'{way} {grams:g} g {"are left" if less else "on"}, and keep still.'
        self._console.print(prompt)
        if loose:
            self._touch(load, 0.0, '+x')
        elif self._drives:
            self._monitor.touch('press', self._processes.check, force=load.force_n, hold=0.0)
        # Half way between the two is neither.
        most = float('inf')
        if previous is not None:
            ratio = load.force_n / previous[0].force_n
            most = zero.mean_n + 0.5 * (1.0 + ratio) * (previous[1].mean_n - zero.mean_n)
        refused: list[ForceCalibrationError] = []

        def is_plateau(stretch: Stretch) -> bool:
            if stretch.end_s - stretch.start_s < HOLD_S or stretch.mean_n > most:
                return False
            if abs(stretch.mean_n - zero.mean_n) < CONTACT_N:
                return False
            try:
                plateau_of(stretch, zero, None)
            except ForceCalibrationError as error:
                refused[:] = [error]
                return False
            return True

        found = self._wait_steady(f'{grams:g} g', is_plateau, refused)
        self._console.print(
            f'  {grams:g} g: estimate {found.mean_n - zero.mean_n:.3f} N,'
            f' creep {found.creep_n_per_s:+.4f} N/s',
            highlight=False,
        )
        return found

    def _take_off(self, load: Stretch) -> Stretch:
        """Prompt to release the sensor and return the zero afterwards."""
        self._console.print('Take it off, and do not touch the sensor.')
        if self._drives:
            self._monitor.touch('release', self._processes.check)
        zero = self._session.zeros[-1]
        refused = [zero_lost(zero.mean_n, load.mean_n)]

        def is_zero(stretch: Stretch) -> bool:
            if stretch.end_s - stretch.start_s < SHORTEST_S:
                return False
            back = abs(stretch.mean_n - zero.mean_n) < CONTACT_N
            if not back:
                refused[:] = [zero_lost(zero.mean_n, stretch.mean_n)]
            return back

        return self._wait_steady('zero', is_zero, refused)

    def _wait_steady(
        self,
        what: str,
        is_it: Callable[[Stretch], bool],
        refused: Sequence[ForceCalibrationError] = (),
    ) -> Stretch:
        return self._wait(what, [0], lambda spans: is_it(spans[0]), refused)[0]

    def _wait_sideways(
        self, what: str, is_it: Callable[[Both], bool], refused: Sequence[ForceCalibrationError]
    ) -> Both:
        x, y = self._wait(what, [1, 2], lambda spans: is_it((spans[0], spans[1])), refused)
        return x, y

    def _wait(
        self,
        what: str,
        axes: list[int],
        is_it: Callable[[tuple[Stretch, ...]], bool],
        refused: Sequence[ForceCalibrationError],
    ) -> tuple[Stretch, ...]:
        """Wait until forces from now on are steady, and show them meanwhile.

        Args:
            what: What is waited for.
            axes: Which forces: normal, x, y.
            is_it: Whether recent stretches are what is waited for.
            refused: Why what was seen meanwhile could not be used, filled by `is_it`.

        Raises:
            ForceCalibrationError: It was not found in time.
            GraphError: No force arrives for `SILENCE_S`.
        """
        first = self._monitor.force_count
        heard, seen = time.monotonic(), first
        with self._console.status(what) as status:
            while True:
                time.sleep(POLL_S)
                self._processes.check()
                count = self._monitor.force_count
                if count > seen:
                    heard, seen = time.monotonic(), count
                elif time.monotonic() - heard > SILENCE_S:
                    raise GraphError(f'no force for {SILENCE_S:.0f} s while waiting for {what}')
                if seen - first < 2:
                    continue
                t_s, forces = (each[first - self._begin :] for each in self._series())
                series = forces[:, axes].T
                recent = t_s > t_s[-1] - RECENT_S
                for spans in steady_together(t_s[recent], *series[:, recent]):
                    if is_it(spans):
                        return spans
                left_s = PATIENCE_S - (t_s[-1] - t_s[0])
                now = ', '.join(f'{each[-50:].mean():6.3f}' for each in series)
                status.update(f'{what}: {now} N, {left_s:3.0f} s left')
                if left_s < 0.0:
                    raise refused[-1] if refused else unsteady(t_s, series[0])

    def _series(self) -> tuple[F64, F64]:
        """Return times [s, sensor time] and forces [N] [T, 3] since the sensor was tared."""
        _, stamps, force = self._monitor.force()
        forces = np.column_stack([force, self._monitor.sideways()[: len(force)]])
        return 1e-9 * (stamps[self._begin :] - stamps[0]), forces[self._begin :]

    def _reference(self) -> tuple[F64, F64, F64]:
        """Return times of the reference on the clock of the plateaus [s], and its forces [N]."""
        arrival, stamps, _ = self._monitor.force()
        times, values = self._monitor.reference()
        across = self._monitor.reference_sideways()[: len(times)]
        # What arrived together belongs together.
        t_s = 1e-9 * np.interp(times - arrival[0], arrival - arrival[0], stamps - stamps[0])
        return t_s, values, across

    def _measured(self) -> list[Load]:
        """Return the loads by the reference sensor."""
        t_s, values, _ = self._reference()
        return reference_loads(t_s, values, self._session.plateaus, self._session.zeros)


def _is_near(mean_n: complex, most_n: float, span: Both) -> bool:
    return abs(mean_of(span) - mean_n) < most_n


def is_still(stretch: Stretch) -> bool:
    """Return whether nothing moves, as on a sensor that nobody touches."""
    return stretch.sd_n < CONTACT_N
