# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Values that the parts could not use are refused; the launch file names existing parameters."""

from __future__ import annotations

import math

import pytest

from mixtac_core.node.parameters import ParameterError, build
from mixtac_slip_control.parameters import SlipControlParameters


@pytest.mark.parametrize(
    'bad',
    [
        {'gain': -1.0},
        {'min_flow': 0.0},
        {'max_force': 0.0},
        {'force_share': 1.1},
        {'slip_force': math.nan},
        {'grip_margin': 0.9},
        {'max_total': 3e-3},
        {'lead': 5e-3},
        {'law': 'both'},
        {'gripper': 'suction'},
        {'normal': '0 0 0'},
        {'normal': '0 0'},
        {'normal': '0 0 up'},
        {'workspace': '1 2 3'},
        {'contact': '120'},
        {'controller': '/'},
    ],
)
def test_unusable_values_are_refused(bad: dict[str, object]) -> None:
    for make in (
        lambda: SlipControlParameters(**bad),  # type: ignore[arg-type]
        lambda: build(SlipControlParameters, bad),
    ):
        with pytest.raises(ParameterError) as caught:
            make()
        assert any(name in str(caught.value) for name in bad)


def test_text_gives_numbers() -> None:
    p = SlipControlParameters(normal='0 1.5 -2e-1', contact='120 90.5')
    assert p.normal_vector == (0.0, 1.5, -0.2)
    assert p.contact_place == (120.0, 90.5)
    assert SlipControlParameters().contact_place is None
    assert p.workspace_limits == (-0.8, 0.8, -0.8, 0.8, 0.0, 1.2)
