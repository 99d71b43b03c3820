# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Where the arm is, whether it follows the plan, and whether its controller got every plan in time.

Measured joint positions are compared with the plan over the time by which the arm may lag: along
the advance by distance, across it joint by joint. The sag of the arm at the start is subtracted.
Commanded positions, where the controller reports them, are compared over one period: they deviate
from the plan when the controller started a trajectory too late.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from mixtac_core.events.arrays import Floats
from mixtac_slip_control.arm.planner import AdvancePlanner, JointLine
from mixtac_slip_control.errors import ArmError
from mixtac_slip_control.parameters import CONTROLLER_PERIOD_S, SlipControlParameters

ARM_LAG_S: Final = 4e-3
"""Delay from commanded to actual position of the arm [s]: 3 to 4 ms on an FR3 that is commanded by
positions."""
MAX_FOLLOWING_M: Final = 3e-4
"""Largest difference between measured and commanded advance, beyond the lag of the arm [m]."""
MAX_SAG_RAD: Final = 5e-3
"""Largest difference of a joint from its commanded position, across the advance [rad]."""
MAX_JOINT_AGE_S: Final = 0.05
"""Age of joint states and of the controller's state above which slip control stops [s]."""
LAGS: Final = 5.0
"""Lags after which the arm has followed its command to 1 %."""
STAMP_S: Final = 0.02
"""By which the stamps of joint states and the lag of the arm may be off [s]."""
TRACK: Final = 64
"""Measured advances kept: for 64 ms at 1 kHz."""
INSTANTS: Final = 8
"""Times at which the plan is looked at."""
COMMAND_M: Final = 2e-6
"""Deviation of the command along the advance that counts as none [m]: corrected within a cycle of
1 ms it takes half of the FR3's acceleration."""
COMMAND_RAD: Final = 2e-5
"""The same of a joint across the advance [rad]."""
REST_RAD: Final = 1e-6
"""Change of a command from one message to the next that counts as rest [rad]."""


class FollowingWatch:
    """Compares the reports of the arm and of its controller with the plan.

    All times are on the clock of trajectories [s].

    Args:
        parameters: Lead and name of the controller.
        planner: Planner of the motion.

    Attributes:
        lost: Why the arm does not follow the plan; empty if it does. Kept until the next start.
        needs_commands: Whether the commanded positions must arrive.
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
        self._track = np.empty((2, 0))

    @property
    def ready(self) -> bool:
        """Whether the arm was measured at the start of the plan; it may not be moved before."""
        return self._sag is not None or self._planner.line is None

    def start(self, settled_s: float, measured: Floats, commanded: Floats | None) -> None:
        """Watch a plan from rest.

        Args:
            settled_s: Time from which the arm is at the start of the plan [s].
            measured: Joint positions (n,) [rad].
            commanded: Commanded joint positions (n,) [rad]; None if the arm is first moved to the
                measured ones.

        Raises:
            ArmError: The arm is far from its commanded positions.
        """
        self.lost = ''
        self._from_s, self._sag, self._track = settled_s, None, np.empty((2, 0))
        if commanded is not None:
            self._sag = measured - commanded
            self._check_sag(self._sag)
            if self.lost:
                raise ArmError(self.lost, remedy='let its controller bring it there first')

    def on_measured(self, q: Floats, stamp_s: float) -> None:
        """Compare measured joint positions (n,) [rad] with the plan."""
        line = self._planner.line
        if self.lost or line is None or stamp_s < self._from_s:
            return
        if self._sag is None:
            self._sag = q - line.at(self._planner.advance_at(stamp_s))
            self._check_sag(self._sag)
            return
        first_s = stamp_s - LAGS * ARM_LAG_S - STAMP_S
        along, nearest, across = self._compare(line, q - self._sag, first_s, stamp_s)
        self._track = np.hstack([self._track[:, 1 - TRACK :], [[stamp_s], [along]]])
        if abs(along - nearest) > MAX_FOLLOWING_M:
            self.lost = (
                f'the arm does not follow: it has advanced by {1e3 * along:.2f} mm where '
                f'{1e3 * nearest:.2f} mm were commanded '
                f'({1e3 * MAX_FOLLOWING_M:g} mm allowed)'
            )
        else:
            self._check_sag(across)

    def advance_at(self, t_s: float, delay_s: float) -> tuple[float, float]:
        """Return the measured advance at a time, and its standard deviation [m].

        After the latest joint state it is that one: it lies behind the arm, so that the contact
        looks stiffer and the answer is shorter. Without fresh joint states it is the planned one.

        Args:
            t_s: The time [s].
            delay_s: By how much earlier it may in truth have been [s].
        """
        latest_s = float(self._track[0, -1]) if self._track.size else -math.inf
        if t_s > latest_s + MAX_JOINT_AGE_S:
            return self._planner.advance_at(t_s), 0.0
        before, place = np.interp((t_s - delay_s, t_s), *self._track).tolist()
        return place, 0.5 * abs(place - before)

    def on_commanded(self, q: Floats, stamp_s: float) -> None:
        """Compare commanded joint positions (n,) [rad] of a time [s] with the plan."""
        if stamp_s < self._commanded_s - 1.0:
            self._moved_s = -math.inf  # the clock has started anew
        before, line = self._commanded, self._planner.line
        if before is not None and np.abs(q - before).max() > REST_RAD:
            self._moved_s = stamp_s
        self._commanded, self._commanded_s = q, stamp_s
        if self.lost or line is None or stamp_s < self._from_s:
            return
        ahead_s = 1.5 * CONTROLLER_PERIOD_S
        along, nearest, across = self._compare(line, q, stamp_s, stamp_s + ahead_s)
        off = float(np.abs(across).max())
        if abs(along - nearest) > COMMAND_M or off > COMMAND_RAD:
            self.lost = (
                f'the controller does not carry out the plan ({1e6 * abs(along - nearest):.0f} um '
                f'and {1e3 * off:.2f} mrad off): a trajectory came later than lead = '
                f'{1e3 * self._parameters.lead:g} ms allows, or another client moves the arm'
            )

    def commanded(self, now_s: float) -> Floats | None:
        """Return the joint positions (n,) that the controller commands [rad], None if unknown."""
        fresh = abs(now_s - self._commanded_s) <= MAX_JOINT_AGE_S
        return self._commanded if fresh else None

    def reason_not_to_enable(self, measured_s: float, now_s: float) -> str | None:
        """Return why the controller is not ready for a plan, or None.

        Args:
            measured_s: Time of the latest joint positions [s].
            now_s: Now [s].
        """
        # The sag is the distance of the arm from its command, once it has followed.
        if measured_s < self._moved_s + LAGS * ARM_LAG_S + STAMP_S:
            return 'the controller moves the arm, or has just done so: try again in a moment'
        return self._unwatched(now_s)

    def fault(self, now_s: float) -> str | None:
        """Return why the plan must stop, or None."""
        return self.lost or self._unwatched(now_s)

    def _unwatched(self, now_s: float) -> str | None:
        if not self.needs_commands or self.commanded(now_s) is not None:
            return None
        return (
            f'no state of the controller came on {self._parameters.controller}/controller_state in '
            f'the last {1e3 * MAX_JOINT_AGE_S:g} ms; is control_msgs installed?'
        )

    def _check_sag(self, off: Floats) -> None:
        """Record that a joint is too far from its position; differences are (n,) [rad]."""
        joint = int(np.abs(off).argmax())
        if abs(off[joint]) > MAX_SAG_RAD:
            self.lost = (
                f'the arm is not where it was led: joint {joint + 1} is off by '
                f'{abs(off[joint]):.4f} rad ({MAX_SAG_RAD:g} rad allowed)'
            )

    def _compare(
        self, line: JointLine, q: Floats, first_s: float, last_s: float
    ) -> tuple[float, float, Floats]:
        """Return advance of q, the nearest one planned in a time [m], difference across (n,)."""
        step_s = (last_s - first_s) / (INSTANTS - 1)
        planned = [self._planner.advance_at(first_s + k * step_s) for k in range(INSTANTS)]
        low, high = min(planned), max(planned)
        slope = line.slope
        along = float(slope @ (q - line.start)) / float(slope @ slope)
        nearest = min(max(along, low), high)
        return along, nearest, q - line.at(along)
