# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Edges of a trigger line as anchors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_fger.alignment.align import arrived_together, fit_edges
from mixtac_fger.alignment.clock_fit import AmbiguousImpulsesError, DriftError, NoImpulseError

EPOCH_US = 1_700_000_000_000_000


@given(
    gaps=st.lists(st.integers(20_000, 3_000_000), min_size=4, max_size=20, unique=True),
    drift=st.floats(-1e-4, 1e-4),
    missing=st.integers(0, 1),
)
def test_edges_give_the_clocks_to_microseconds(gaps: list[int], drift: float, missing: int) -> None:
    camera = EPOCH_US + np.cumsum([0, 2_000_000, *gaps])
    reference = 5.25 + (1.0 + drift) * (camera - EPOCH_US) * 1e-6
    fit = fit_edges(camera.astype(np.int64), reference)
    assert np.abs(fit.to_reference(camera) - reference).max() < 2e-6
    assert fit.method == 'hardware_edges'
    assert len(fit.anchors) == len(camera) - 0 * missing


def test_edges_missing_on_one_side_are_left_out() -> None:
    rng = np.random.default_rng(3)
    camera = np.cumsum(rng.integers(50_000, 900_000, 30)).astype(np.int64)
    reference = 100.0 + camera * 1e-6
    fit = fit_edges(camera[2:], np.delete(reference, [5, 17])[:-3])
    assert abs(float(fit.to_reference(0)) - 100.0) < 1e-6
    assert len(fit.anchors) == 23


def test_even_edges_with_one_missing_are_ambiguous() -> None:
    camera = (np.arange(20) * 500_000).astype(np.int64)
    with pytest.raises(AmbiguousImpulsesError):
        fit_edges(camera, np.arange(19) * 0.5)


def test_as_many_even_edges_are_the_same_ones_only_if_none_came_before() -> None:
    camera = (np.arange(20) * 500_000).astype(np.int64)
    shifted = np.arange(20) * 0.5 - 0.5
    assert fit_edges(camera, shifted).to_reference(0) == pytest.approx(-0.5)
    with pytest.raises(AmbiguousImpulsesError):
        fit_edges(camera, shifted, complete=False)


def test_edges_are_paired_by_their_arrival_only_where_that_is_certain() -> None:
    camera = 1_000_000_000 * np.arange(20)
    late = np.random.default_rng(5).integers(0, 30_000_000, 20)
    assert arrived_together(camera, camera + late)
    assert not arrived_together(camera, camera + 1_000_000_000)
    assert not arrived_together(camera[:-1], (camera + late)[1:])
    assert not arrived_together(camera[:-1], camera)
    assert not arrived_together(camera[:2], camera[:2])


def test_a_repeated_edge_counts_once() -> None:
    camera = np.cumsum(np.random.default_rng(6).integers(50_000, 900_000, 20)).astype(np.int64)
    fit = fit_edges(np.append(camera, camera[7]), 100.0 + camera * 1e-6, complete=True)
    assert len(fit.anchors) == 20


def test_edges_that_make_no_map_are_refused() -> None:
    camera = np.array([0, 1_000_000, 2_500_000], np.int64)
    with pytest.raises(NoImpulseError):
        fit_edges(camera, np.array([1.0]))
    with pytest.raises(NoImpulseError):
        fit_edges(camera[:2], 5.0 + camera[:2] * 1e-6)
    with pytest.raises((NoImpulseError, DriftError)):
        fit_edges(camera, np.array([0.0, 1.3, 2.9]))
