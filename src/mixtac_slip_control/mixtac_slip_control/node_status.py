# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the slip control node says of itself."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from mixtac_slip_control.interlock import InterlockState
from mixtac_slip_control.safety import EVENTS, FORCE, HEARTBEAT, JOINTS

if TYPE_CHECKING:
    from mixtac_slip_control.controller import SlipController
    from mixtac_slip_control.slip_step import SlipStep

OK, WARN, ERROR = range(3)
"""Levels of `diagnostic_msgs/DiagnosticStatus`."""
AGES: Final = (EVENTS, FORCE, JOINTS, HEARTBEAT)


@dataclass(slots=True)
class FeedCounts:
    """What came in and went out.

    Attributes:
        packets: Event packets.
        lost: Packets missing by their sequence numbers.
        refused: Messages that could not be read.
        problem: The latest reason for one, empty if there was none.
        windows: Slip states published.
        trajectories: Trajectories published.
    """

    packets: int = 0
    lost: int = 0
    refused: int = 0
    problem: str = ''
    windows: int = 0
    trajectories: int = 0


def node_status(
    controller: SlipController, counts: FeedCounts, latest: SlipStep | None, now_s: float
) -> tuple[int, str, dict[str, object]]:
    """Return level, one line for people, and figures by name.

    Args:
        controller: The controller.
        counts: Of the node.
        latest: The latest window, None before the first.
        now_s: Host time [s].
    """
    values: dict[str, object] = {
        'state': controller.interlock.state.name.lower(),
        'packets': counts.packets,
        'lost packets': counts.lost,
        'unreadable messages': counts.refused,
        'windows': counts.windows,
        'skipped windows': controller.features.slicer.skipped_windows,
        'late events': controller.features.slicer.late_events,
        'clock restarts': controller.features.slicer.restarts,
        'trajectories': counts.trajectories,
        'advance limit [m]': controller.advance_limit,
        **{f'{name} age [s]': _age(controller, name, now_s) for name in AGES},
    }
    if latest is not None:
        values |= {
            'count threshold [events]': latest.threshold,
            'flow threshold [px]': latest.flow_threshold,
            'total advance [m]': latest.total_advance,
        }
    return *_judge(controller, counts, latest, now_s), values


def _age(controller: SlipController, name: str, now_s: float) -> object:
    age = controller.watch.age(name, now_s)
    return age if math.isfinite(age) else 'never'


def _judge(
    controller: SlipController, counts: FeedCounts, latest: SlipStep | None, now_s: float
) -> tuple[int, str]:
    if controller.interlock.state is InterlockState.STOPPED:
        return ERROR, f'stopped: {controller.interlock.reason}'
    if latest is None:
        problem = counts.problem or 'check that the driver runs'
        return WARN, f'no events yet: {problem}'
    if not controller.judge.learned:
        return WARN, 'learning the background: keep the contact still'
    if controller.enabled:
        return OK, 'enabled'
    fault = controller.watch.fault(now_s) if controller.has_arm else 'no arm'
    return OK, f'watching; cannot be enabled: {fault}' if fault else 'watching; ready'
