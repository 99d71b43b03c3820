# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whether the arm is where the plan leads it, and whether its controller got every plan in time.

Measured joint positions are compared with the plan over the time that the arm may lag behind: along
the advance by distance, across it joint by joint. What they differ by at the start is the sag of
the arm and stays out of it. Commanded positions, where the controller reports them, are compared
over a period: they leave the plan when a trajectory was taken up after it had to be in effect.

How long a trajectory takes to the controller cannot be seen from here. What can be measured is how
old the controller's own messages are when they arrive, which take the same way back.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mixtac_slip_control.arm.normal_path import NormalPath
from mixtac_slip_control.arm.planner import AdvancePlanner
from mixtac_slip_control.errors import ArmError
from mixtac_slip_control.parameters import SlipControlParameters

Floats = NDArray[np.float64]

LAGS: Final = 5.0
"""Lags after which the arm has followed its command to 1 %."""
STAMP_S: Final = 0.02
"""By which the stamps of joint states and the lag of the arm may be off [s]."""
INSTANTS: Final = 8
"""Times at which the plan is looked at."""
COMMAND_M: Final = 2e-6
"""Deviation of the command along the advance that counts as none [m]: corrected within a cycle of
1 ms it takes half of the FR3's acceleration."""
COMMAND_RAD: Final = 2e-5
"""The same of a joint across the advance [rad]."""
REST_RAD: Final = 1e-6
"""Change of a command from one message to the next that counts as rest [rad]."""
UNWATCHED_LEAD_S: Final = 6e-3
"""Shortest lead for which a controller need not report what it commands [s]."""
FEWEST: Final = 100
"""Messages of the controller from which the transport is known."""
SHARE: Final = 0.99
"""Quantile of their ages that counts as the transport."""


class FollowingWatch:
    """Compares what the arm and its controller report with the plan.

    All times are on the clock of trajectories [s].

    Args:
        parameters: Lead, lag and limits.
        planner: Knows the plan.

    Attributes:
        lost: Why the arm is not where the plan leads it; empty if it is. Kept until the next start.
        needs_commands: Whether what the controller commands must be known; a lead below 6 ms does
            in any case.
    """

    def __init__(self, parameters: SlipControlParameters, planner: AdvancePlanner) -> None:
        self._parameters = parameters
        self._planner = planner
        self.lost = ''
        self.needs_commands = False
        self._from_s = math.inf
        self._sag: Floats | None = None
        self._commanded: Floats | None = None
        self._commanded_s = -math.inf
        self._moved_s = -math.inf
        self._ages: list[float] = []

    @property
    def transport_s(self) -> float:
        """Age of the controller's messages at their arrival, 99 of 100 [s]; NaN if unknown."""
        enough = len(self._ages) >= FEWEST
        return float(np.quantile(self._ages, SHARE)) if enough else math.nan

    @property
    def ready(self) -> bool:
        """Whether the arm was seen where the plan begins: before that nothing may move it."""
        return self._sag is not None or self._planner.path is None

    def configure(self, parameters: SlipControlParameters) -> None:
        """Use other limits from now on."""
        self._parameters = parameters

    def start(self, settled_s: float, measured: Floats, commanded: Floats | None) -> None:
        """Watch a plan from rest.

        Args:
            settled_s: From when the arm is where the plan begins [s].
            measured: Joint positions (n,) [rad].
            commanded: Commanded joint positions (n,) [rad]; None where the arm is led to the
                measured ones first.

        Raises:
            ArmError: The arm is far from where it is commanded to be.
        """
        self.lost = ''
        self._from_s, self._sag = settled_s, None
        if commanded is not None:
            self._sag = measured - commanded
            self._check_sag(self._sag)
            if self.lost:
                raise ArmError(self.lost, remedy='let its controller bring it there first')

    def on_measured(self, q: Floats, stamp_s: float) -> None:
        """Compare measured joint positions (n,) [rad] with the plan."""
        path = self._planner.path
        if self.lost or path is None or stamp_s < self._from_s:
            return
        if self._sag is None:
            self._sag = q - path.derivatives(self._planner.advance_at(stamp_s))[0]
            self._check_sag(self._sag)
            return
        p = self._parameters
        first_s = stamp_s - LAGS * p.arm_lag - STAMP_S
        along, nearest, across = self._compare(path, q - self._sag, first_s, stamp_s)
        if abs(along - nearest) > p.max_following_error:
            self.lost = (
                f'the arm does not follow: it has advanced by {1e3 * along:.2f} mm where '
                f'{1e3 * nearest:.2f} mm were commanded '
                f'({1e3 * p.max_following_error:g} mm allowed)'
            )
        elif (off := float(np.abs(across).max())) > p.max_displacement:
            self.lost = (
                f'the arm is not where it was led: joint {int(np.abs(across).argmax()) + 1} is off '
                f'by {off:.4f} rad ({p.max_displacement:g} rad allowed)'
            )

    def on_report(self, q: Floats, stamp_s: float, now_s: float) -> None:
        """Take commanded joint positions (n,) [rad] of a backend that tells late plans itself.

        Args:
            q: What the controller commands.
            stamp_s: Its time [s].
            now_s: When the message arrived [s].
        """
        if stamp_s < self._commanded_s - 1.0:
            self._moved_s = -math.inf  # the clock started anew
        self._ages = [*self._ages[1 - 2 * FEWEST :], now_s - stamp_s]
        before = self._commanded
        if before is not None and np.abs(q - before).max() > REST_RAD:
            self._moved_s = stamp_s
        self._commanded, self._commanded_s = q, stamp_s

    def on_commanded(self, q: Floats, stamp_s: float, now_s: float) -> None:
        """Take commanded joint positions (n,) [rad] as `on_report`, and hold them to the plan."""
        self.on_report(q, stamp_s, now_s)
        path = self._planner.path
        if self.lost or path is None or stamp_s < self._from_s:
            return
        ahead_s = 1.5 * self._parameters.controller_period
        along, nearest, across = self._compare(path, q, stamp_s, stamp_s + ahead_s)
        off = float(np.abs(across).max())
        if abs(along - nearest) > COMMAND_M or off > COMMAND_RAD:
            self.lost = (
                f'the controller does not carry out the plan ({1e6 * abs(along - nearest):.0f} um '
                f'and {1e3 * off:.2f} mrad off): a trajectory came later than lead = '
                f'{1e3 * self._parameters.lead:g} ms allows, or another client moves the arm'
            )

    def commanded(self, now_s: float) -> Floats | None:
        """Return the joint positions (n,) that the controller commands [rad], None if unknown."""
        fresh = abs(now_s - self._commanded_s) <= self._parameters.max_joint_age
        return self._commanded if fresh else None

    def reason_not_to_enable(self, measured_s: float, now_s: float) -> str | None:
        """Return why the controller is not ready for a plan, or None.

        Args:
            measured_s: Time of the latest joint positions [s].
            now_s: Now [s].
        """
        p = self._parameters
        # The sag is what the arm is away from its command, once it has followed.
        if measured_s < self._moved_s + LAGS * p.arm_lag + STAMP_S:
            return 'the controller moves the arm, or has just done so: try again in a moment'
        if unwatched := self._unwatched(now_s):
            return unwatched
        if p.lead >= UNWATCHED_LEAD_S:
            return None
        transport_s = self.transport_s
        if transport_s < 0.0:
            return (
                f'the state of the controller comes {-1e3 * transport_s:.1f} ms before its time: '
                f'set the clocks of both hosts, which lead = {1e3 * p.lead:g} ms needs'
            )
        if not transport_s + 2.0 * p.controller_period <= p.lead:
            measured = 'not measured yet' if math.isnan(transport_s) else f'{1e3 * transport_s:.1f}'
            return (
                f'lead = {1e3 * p.lead:g} ms is too short for a transport of {measured} ms and two '
                f'periods of the controller: raise lead, or lower the load of this host'
            )
        return None

    def fault(self, now_s: float) -> str | None:
        """Return why the plan must not go on, or None."""
        if self.lost:
            return self.lost
        return self._unwatched(now_s)

    def _unwatched(self, now_s: float) -> str | None:
        p = self._parameters
        short = p.lead < UNWATCHED_LEAD_S
        if not (short or self.needs_commands) or self.commanded(now_s) is not None:
            return None
        topic = p.controller_state_topic
        where = f'on {topic} ' if topic != 'none' else ''
        what = f'no state of the controller came {where}in the last {1e3 * p.max_joint_age:g} ms'
        if short:
            return f'{what}, which lead = {1e3 * p.lead:g} ms needs'
        return f'{what}: install control_msgs, or set controller_state_topic to none'

    def _check_sag(self, sag: Floats) -> None:
        allowed, off = self._parameters.max_displacement, float(np.abs(sag).max())
        if off > allowed:
            self.lost = (
                f'the arm is not where it was led: joint {int(np.abs(sag).argmax()) + 1} is off by '
                f'{off:.4f} rad ({allowed:g} rad allowed)'
            )

    def _compare(
        self, path: NormalPath, q: Floats, first_s: float, last_s: float
    ) -> tuple[float, float, Floats]:
        """Return advance of q, the nearest one planned in a time [m], difference across (n,)."""
        step_s = (last_s - first_s) / (INSTANTS - 1)
        planned = [self._planner.advance_at(first_s + k * step_s) for k in range(INSTANTS)]
        low, high = min(planned), max(planned)
        start, slope = path.derivatives(0.5 * (low + high))[:2]
        along = 0.5 * (low + high) + float(slope @ (q - start)) / float(slope @ slope)
        nearest = min(max(along, low), high)
        # Within a plan's few millimetres the path bends: the polynomial, as far as it reaches.
        place = path.derivatives(min(max(along, path.lower), path.upper))[0]
        return along, nearest, q - place
