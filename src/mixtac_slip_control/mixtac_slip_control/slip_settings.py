# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Settings of everything that the slip controller is made of."""

from __future__ import annotations

from dataclasses import dataclass, field

from mixtac_slip_control.advance_law import AdvanceSettings
from mixtac_slip_control.contact_stiffness import StiffnessSettings
from mixtac_slip_control.flow_guide import GuideSettings
from mixtac_slip_control.safety import SafetySettings
from mixtac_slip_control.slip_judge import JudgeSettings
from mixtac_slip_control.stiffness_probe import ProbeSettings


@dataclass(frozen=True, slots=True)
class SlipSettings:
    """Settings of all parts.

    Attributes:
        window_us: Counting window [us].
        guide: Where the contact is in the image.
        judge: Of the detectors.
        advance: Gain and limits of the advance.
        safety: Limits and ages.
        stiffness: What is assumed of the contact's stiffness.
        probe: How it is learned when enabled.
        arm_lag_s: From a commanded to the arm's true place [s]: events of the advance come so much
            later.
        settling_s: Time after enabling in which the arm's controller is led to the measured
            positions and slip is not answered [s].
    """

    window_us: int = 1000
    guide: GuideSettings = field(default_factory=GuideSettings)
    judge: JudgeSettings = field(default_factory=JudgeSettings)
    advance: AdvanceSettings = field(default_factory=AdvanceSettings)
    safety: SafetySettings = field(default_factory=SafetySettings)
    stiffness: StiffnessSettings = field(default_factory=StiffnessSettings)
    probe: ProbeSettings = field(default_factory=ProbeSettings)
    arm_lag_s: float = 4e-3
    settling_s: float = 0.0
