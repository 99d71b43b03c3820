# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What diagnostics say about slip control: state, ages of the inputs, counts of messages."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

from mixtac_events.sequence import SequenceCounter
from mixtac_node.diagnostics import ERROR, OK, WARN
from mixtac_slip_control.controller import SlipController, SlipStep
from mixtac_slip_control.safety import EVENTS, FORCE, FRAMES, HEARTBEAT, JOINTS, InterlockState

AGES: Final = (EVENTS, FRAMES, FORCE, JOINTS, HEARTBEAT)


@dataclass(slots=True)
class FeedCounts:
    """Messages of the node, in and out.

    Attributes:
        packets: Event packets received and missing, by their sequence numbers.
        refused: Messages that could not be read.
        problem: Why the latest of them could not, empty if there was none.
        windows: Slip states published.
        trajectories: Trajectories sent to the arm.
    """

    packets: SequenceCounter = field(default_factory=SequenceCounter)
    refused: int = 0
    problem: str = ''
    windows: int = 0
    trajectories: int = 0


def node_status(
    controller: SlipController, counts: FeedCounts, latest: SlipStep | None, now_s: float
) -> tuple[int, str, dict[str, object]]:
    """Return level, a one-line summary, and figures by name.

    Args:
        controller: The controller.
        counts: Messages of the node.
        latest: Result of the latest window, None before the first.
        now_s: Host time [s].
    """
    slicer = controller.features.slicer
    values: dict[str, object] = {
        'state': controller.interlock.state.name.lower(),
        'packets': counts.packets.received,
        'lost packets': counts.packets.lost,
        'unreadable messages': counts.refused,
        'windows': counts.windows,
        'skipped windows': slicer.skipped_windows,
        'late events': slicer.late_events,
        'clock restarts': slicer.restarts,
        'trajectories': counts.trajectories,
        'advance limit [m]': controller.advance_limit,
    }
    for name in AGES:
        age = controller.watch.age(name, now_s)
        values[f'{name} age [s]'] = age if math.isfinite(age) else 'never'
    values['contrast [1/px]'] = controller.features.contrast
    if controller.following is not None:
        values['transport [ms]'] = 1e3 * controller.following.transport_s
    if latest is not None:
        values |= {
            'count threshold [events]': latest.threshold,
            'flow threshold [px]': latest.flow_threshold,
            'total advance [m]': latest.total_advance,
        }
    return *_summary(controller, counts, latest, now_s), values


def _summary(
    controller: SlipController, counts: FeedCounts, latest: SlipStep | None, now_s: float
) -> tuple[int, str]:
    if controller.interlock.state is InterlockState.STOPPED:
        return ERROR, f'stopped: {controller.interlock.reason}'
    if latest is None:
        problem = counts.problem or 'check that the driver runs'
        return WARN, f'no events yet: {problem}'
    if not controller.detectors.learned:
        return WARN, 'learning the background: keep the contact still'
    if controller.enabled:
        return OK, 'enabled'
    reason = controller.reason(now_s)
    return OK, f'watching; cannot be enabled: {reason}' if reason else 'watching; ready'
