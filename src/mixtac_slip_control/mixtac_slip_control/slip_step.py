# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the controller says of one window."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SlipStep:
    """What one window led to; the fields are those of `mixtac_msgs/SlipState`.

    Attributes:
        end_us: End of the window, camera clock [us].
        count: Events in the window.
        background: Middle of the counts at rest.
        background_sigma: Scale of the tail of the counts at rest.
        threshold: Count above which the paper's law says slip.
        count_slipping: What the paper's law says.
        flow: Translation of the skin [px per contrast threshold].
        flow_threshold: Translation above which the flow detector says slip.
        flow_slipping: What the flow detector says.
        slipping: What counts, by the choice of detector.
        state: Number of the `InterlockState`.
        enabled: Whether the arm may follow slip.
        advance: Asked for by this window, along the contact normal [m].
        total_advance: Since enabling [m].
    """

    end_us: int
    count: int
    background: float
    background_sigma: float
    threshold: float
    count_slipping: bool
    flow: float
    flow_threshold: float
    flow_slipping: bool
    slipping: bool
    state: int
    enabled: bool
    advance: float
    total_advance: float
