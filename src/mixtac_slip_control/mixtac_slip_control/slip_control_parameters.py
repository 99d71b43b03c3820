# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the slip control node: each gain with its unit and effect."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_node.parameters import parameter
from mixtac_slip_control.advance_law import AdvanceSettings
from mixtac_slip_control.background import BackgroundSettings
from mixtac_slip_control.controller import SlipSettings
from mixtac_slip_control.detector import DetectorSettings


@dataclass(frozen=True)
class SlipControlParameters:
    """How slip is told from the background, and how far to advance against it."""

    window: float = parameter(
        1e-3,
        'Counting window. Longer counts scatter less and answer later; gains and thresholds are '
        'per window.',
        unit='s',
        minimum=2e-4,
        maximum=2e-2,
        read_only=True,
    )
    learning_time: float = parameter(
        0.5,
        'Time at rest from which the background is first learned.',
        unit='s',
        minimum=0.05,
        maximum=60.0,
    )
    background_time_constant: float = parameter(
        5.0,
        'Time over which the background follows slow changes (temperature, light), at rest only. '
        'Shorter follows faster and learns slow slip away.',
        unit='s',
        minimum=0.1,
        maximum=3600.0,
    )
    settle_time: float = parameter(
        0.1,
        'Time without slip after which the contact is at rest and the background follows again.',
        unit='s',
        minimum=0.0,
        maximum=60.0,
    )
    threshold_sigma: float = parameter(
        6.0,
        'Threshold N_th above the background, in its spreads. Higher gives fewer false alarms and '
        'later detection.',
        minimum=0.0,
        maximum=100.0,
    )
    threshold_min_excess: float = parameter(
        20.0,
        'Smallest threshold above the background, for very quiet cameras.',
        unit='events per window',
        minimum=0.0,
        maximum=1e5,
    )
    release_ratio: float = parameter(
        0.5,
        'Part of the way from the background to the threshold below which a window is quiet.',
        minimum=0.0,
        maximum=1.0,
    )
    release_time: float = parameter(
        5e-3, 'Quiet time that ends a slip.', unit='s', minimum=2e-4, maximum=1.0
    )
    gain: float = parameter(
        3e-8,
        'k of the law: advance per event above the threshold. Higher arrests sooner; the advance '
        'itself makes events, so that too high a gain runs to max_total.',
        unit='m/event',
        minimum=0.0,
        maximum=1e-5,
    )
    max_step: float = parameter(
        5e-5,
        'Largest advance in one window; with window it limits the speed asked for.',
        unit='m',
        minimum=0.0,
        maximum=1e-3,
    )
    max_total: float = parameter(
        1e-3,
        'Largest sum of advances since enabling: allowed extra force divided by the stiffness of '
        'the contact. The guard that keeps gel and object whole.',
        unit='m',
        minimum=0.0,
        maximum=2e-2,
    )
    hold_time: float = parameter(
        0.2,
        'Time without slip for which the advance is held before back_off may begin.',
        unit='s',
        minimum=0.0,
        maximum=3600.0,
    )
    back_off: float = parameter(
        0.0,
        'Speed of the return after hold_time; 0 holds for ever. Too fast lets the object slip '
        'again.',
        unit='m/s',
        minimum=0.0,
        maximum=1e-2,
    )

    @property
    def window_us(self) -> int:
        """Counting window [us]."""
        return round(self.window * 1e6)

    def settings(self) -> SlipSettings:
        """Return what the core needs of these, in windows.

        Raises:
            SlipControlError: Times too short for the window.
        """
        return SlipSettings(
            background=BackgroundSettings(
                learning_windows=self._windows(self.learning_time),
                time_constant_windows=self.background_time_constant / self.window,
            ),
            detector=DetectorSettings(
                n_sigma=self.threshold_sigma,
                min_excess=self.threshold_min_excess,
                release_ratio=self.release_ratio,
                release_windows=max(1, self._windows(self.release_time)),
            ),
            advance=AdvanceSettings(
                gain=self.gain,
                max_step=self.max_step,
                max_total=self.max_total,
                hold_windows=self._windows(self.hold_time),
                back_off_step=self.back_off * self.window,
            ),
            settle_windows=self._windows(self.settle_time),
        )

    def _windows(self, seconds: float) -> int:
        return round(seconds / self.window)
