# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The parameters refuse what the parts could not use, however they are made."""

from __future__ import annotations

import dataclasses
import math

import pytest

from mixtac_node.parameters import ParameterError, build, specs
from mixtac_slip_control.parameters import SlipControlParameters


@pytest.mark.parametrize(
    'bad',
    [
        {'gain': -1.0},
        {'max_step': math.nan},
        {'events_per_mm': 0.0},
        {'hold_time': -1.0},
        {'max_force': 0.0},
        {'max_joint_age': math.nan},
        {'detector': 'both'},
        {'controller_state_topic': ''},
        {'min_excess': -1.0},
        {'advance_events_per_mm': math.nan},
        {'release_ratio': 1.5},
        {'release_time': 0.0},
        {'min_flow': -1.0},
        {'slow_time': 0.0},
        {'tail_shape': 1.0},
        {'false_alarms_per_hour': 0.0},
        {'probe_advance': -1.0},
        {'probe_speed': 0.0},
        {'stiffest_contact': 0.0},
        {'force_noise': math.nan},
        {'contact_reach': 5.0},
        {'contact_column': 1e9},
        {'window': 0.01, 'max_events_age': 0.02, 'learning_time': 10.0},
        {'learning_time': 0.2, 'window': 0.01},
        {'background_time_constant': 0.5, 'window': 0.01, 'learning_time': 1.0},
    ],
)
def test_values_without_a_meaning_are_refused(bad: dict[str, object]) -> None:
    for make in (
        lambda: SlipControlParameters(**bad),  # type: ignore[arg-type]
        lambda: build(SlipControlParameters, bad),
        lambda: dataclasses.replace(SlipControlParameters(), **bad),
    ):
        with pytest.raises(ParameterError) as caught:
            make()
        assert any(name in str(caught.value) for name in bad)


def test_times_are_given_in_windows() -> None:
    p = SlipControlParameters(window=2e-3, learning_time=1.0)
    assert (p.window_us, p.learning_windows) == (2000, 500)
    assert dataclasses.replace(p, window=1e-3).learning_windows == 1000


def test_every_description_stands_alone() -> None:
    for spec in specs(SlipControlParameters):
        assert spec.description.endswith('.'), spec.name
        assert not spec.description.startswith('The same'), spec.name
