# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The message carries the map exactly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_alignment.clock_fit import Anchor, fit_clock, from_fields, to_fields
from mixtac_alignment.errors import AlignmentError

EPOCH_US = 1_700_000_000_000_000


@given(
    seconds=st.lists(st.integers(1, 40_000_000), min_size=1, max_size=5),
    drift=st.floats(-1e-4, 1e-4),
    offset=st.floats(0.0, 2e9),
)
def test_maps_come_back_exactly(seconds: list[int], drift: float, offset: float) -> None:
    camera = (EPOCH_US + np.cumsum([0, 2_000_000, *seconds])).tolist()
    fit = fit_clock(
        [Anchor(t, offset + (t - EPOCH_US) * 1e-6 * (1.0 + drift), 1e-3) for t in camera]
    )
    back = from_fields(to_fields(fit))
    times = EPOCH_US + np.arange(-50, 50) * 1_234_567
    assert np.array_equal(back.to_reference_ns(times), fit.to_reference_ns(times))
    assert np.array_equal(back.std_at(times), fit.std_at(times))
    assert back.method == fit.method
    assert [a.camera_us for a in back.anchors] == [a.camera_us for a in fit.anchors]
    assert back.residual_rms_s == pytest.approx(fit.residual_rms_s)


def test_the_fields_obey_the_relation_of_the_message() -> None:
    fields = to_fields(
        fit_clock([Anchor(EPOCH_US, 7.5, 1e-3), Anchor(EPOCH_US + 9_000_123, 16.5, 1e-3)])
    )
    for camera, reference in zip(
        fields['camera_anchors'], fields['reference_anchors'], strict=True
    ):
        left = reference - fields['reference_epoch']
        right = fields['a'] * (camera - fields['camera_epoch']) + fields['b']
        assert left == pytest.approx(right, abs=1e-6)


@pytest.mark.parametrize(('name', 'value'), [('a', 0.0), ('a', float('nan')), ('b', float('inf'))])
def test_fields_that_are_no_map_are_refused(name: str, value: float) -> None:
    fields = to_fields(fit_clock([Anchor(0, 7.5, 1e-3), Anchor(9_000_000, 16.5, 1e-3)]))
    with pytest.raises(AlignmentError, match='fit again'):
        from_fields({**fields, name: value})
