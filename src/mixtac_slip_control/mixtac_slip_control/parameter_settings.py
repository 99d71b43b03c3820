# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The node's parameters as settings of the core: seconds become windows, millimetres metres."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixtac_slip_control.advance_law import AdvanceSettings
from mixtac_slip_control.background import BackgroundSettings
from mixtac_slip_control.contact_stiffness import StiffnessSettings
from mixtac_slip_control.detector import CountSettings
from mixtac_slip_control.flow_detector import FlowSettings
from mixtac_slip_control.flow_guide import GuideSettings
from mixtac_slip_control.hysteresis import HysteresisSettings
from mixtac_slip_control.safety import SafetySettings
from mixtac_slip_control.slip_judge import JudgeSettings
from mixtac_slip_control.slip_settings import SlipSettings
from mixtac_slip_control.stiffness_probe import ProbeSettings

if TYPE_CHECKING:
    from mixtac_slip_control.slip_control_parameters import SlipControlParameters


def slip_settings(parameters: SlipControlParameters) -> SlipSettings:
    """Return what the core needs of these, in windows.

    Raises:
        SlipControlError: Times too short for the window, or values that contradict.
    """
    return SlipSettings(
        window_us=parameters.window_us,
        guide=GuideSettings(
            centre_px=(parameters.contact_column, parameters.contact_row),
            reach_px=parameters.contact_reach,
        ),
        judge=_judge(parameters),
        advance=_advance(parameters),
        safety=_safety(parameters),
        stiffness=StiffnessSettings(parameters.stiffest_contact, parameters.force_noise),
        probe=ProbeSettings(
            parameters.probe_advance,
            parameters.probe_force,
            parameters.probe_speed * parameters.window,
        ),
        arm_lag_s=parameters.arm_lag,
    )


def _judge(parameters: SlipControlParameters) -> JudgeSettings:
    background = BackgroundSettings(
        learning_windows=_windows(parameters, parameters.learning_time),
        time_constant_windows=parameters.background_time_constant / parameters.window,
        alarm_probability=parameters.false_alarms_per_hour * parameters.window / 3600.0,
        tail_shape=parameters.tail_shape,
    )
    hysteresis = HysteresisSettings(
        parameters.release_ratio, max(1, _windows(parameters, parameters.release_time))
    )
    return JudgeSettings(
        detector=parameters.detector,
        count=CountSettings(
            background=background,
            min_excess=parameters.min_excess,
            advance_events_per_m=1e3 * parameters.advance_events_per_mm,
            hysteresis=hysteresis,
        ),
        flow=FlowSettings(
            background=background,
            min_flow=parameters.min_flow,
            slow_windows=max(2, _windows(parameters, parameters.slow_time)),
            min_slow_flow=parameters.min_slow_flow,
            advance_flow_per_m=1e3 * parameters.advance_flow_per_mm,
            hysteresis=hysteresis,
        ),
        settle_windows=_windows(parameters, parameters.settle_time),
    )


def _advance(parameters: SlipControlParameters) -> AdvanceSettings:
    return AdvanceSettings(
        gain=parameters.gain,
        events_per_m=1e3 * parameters.events_per_mm,
        memory_windows=parameters.memory_time / parameters.window,
        max_step=parameters.max_step,
        max_total=parameters.max_total,
        hold_windows=_windows(parameters, parameters.hold_time),
        back_off_step=parameters.back_off * parameters.window,
        preload_step=parameters.preload_speed * parameters.window,
        force_band=parameters.force_band,
    )


def _safety(parameters: SlipControlParameters) -> SafetySettings:
    return SafetySettings(
        max_events_age=parameters.max_events_age,
        max_force_age=parameters.max_force_age,
        max_joint_age=parameters.max_joint_age,
        max_heartbeat_age=parameters.max_heartbeat_age,
        max_force=parameters.max_force,
        saturation_count=parameters.saturation_count,
    )


def _windows(parameters: SlipControlParameters, seconds: float) -> int:
    return round(seconds / parameters.window)
