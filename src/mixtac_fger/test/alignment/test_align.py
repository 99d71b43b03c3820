# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The clock map of whole recordings, and of edges, against known clocks, and every refusal."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_fger.alignment.align import align, arrived_together, fit_edges
from mixtac_fger.alignment.clock_fit import (
    AlignmentError,
    AmbiguousImpulsesError,
    DriftError,
    GapError,
    NoImpulseError,
    SaturatedImpulseError,
    ShortBaselineError,
)
from mixtac_fger.alignment.histories import (
    CellEvents,
    FrameFeatures,
    Recording,
    by_cell,
    reduce_frame,
)
from mixtac_fger.alignment.impulses import paired_impulses
from mixtac_fger.alignment.parameters import DEFAULTS

NO_EVENTS = CellEvents(np.zeros(0, np.int64), np.zeros(0, np.uint16), np.zeros(0, np.bool_))


@pytest.fixture(scope='module')
def trial() -> Any:
    world = pytest.importorskip('mixtac_sim.world.trial')
    return world.simulate_trial(9001, 9001, 'oscillation', 8.0, sync=True)


@pytest.fixture
def recording_of(counted: Any) -> Any:
    """Return a function that makes a recording of a trial."""
    return partial(_recording_of, counted)


def _recording_of(counted: Any, trial: Any, *, frames: bool = True) -> Recording:
    values = np.stack([reduce_frame(image, 1023.0) for image in trial.frames])
    return Recording(
        counts=counted(trial.events.t),
        events=by_cell(trial.events, 346, 260),
        frames=FrameFeatures(trial.exposure_start_us, trial.exposure_end_us, values)
        if frames
        else None,
        force_t_s=trial.reference_t_us * 1e-6,
        force=trial.reference_wrench[:, 2],
        edges_us=np.zeros(0, np.int64),
        reference_edges_s=np.zeros(0),
    )


@pytest.mark.parametrize('frames', [True, False])
def test_a_simulated_trial_is_aligned(recording_of: Any, trial: Any, frames: bool) -> None:
    fit = align(recording_of(trial, frames=frames))
    rate, offset_us = trial.clock
    at = np.array([1, 4, 7]) * 1_000_000
    # A camera time maps to the stamp of the sample that shows the force of that moment.
    shown = rate * at + offset_us + trial.reference_delay_us
    error_s = fit.to_reference(at) - 1e-6 * shown
    assert np.abs(error_s).max() < 0.003
    assert (np.abs(error_s) < 2.5 * fit.std_at(at)).all()
    assert fit.method == 'two_impulse'


@pytest.fixture
def pairs_of(counted: Any) -> Any:
    """Return a function that pairs the impulses of events [us] and a force."""
    return lambda events, t, force: paired_impulses(counted(events), t, force, DEFAULTS)


def test_taps_are_paired_and_presses_are_not(scene: Any, pairs_of: Any) -> None:
    case = scene(taps_s=(1.0, 1.9, 12.1, 24.0), heights=(3.0, 2.5, 2.8, 3.1))
    pairs, start_s = pairs_of(*case.recording())
    found = [start_s + pair.reference.time_s for pair in pairs]
    assert found == pytest.approx(case.reference_s(np.array(case.taps_s)), abs=2e-3)
    # Pressing may be negative.
    events, t, force = case.recording()
    pairs, start_s = pairs_of(events, t, 4.0 - force)
    assert found == pytest.approx([start_s + pair.reference.time_s for pair in pairs])


def test_impulses_that_fix_no_map_are_refused(scene: Any, pairs_of: Any) -> None:
    for taps in ((), (2.0,)):
        with pytest.raises(NoImpulseError):
            pairs_of(*scene(taps_s=taps, heights=(3.0,) * len(taps)).recording())
    events, t, force = scene().recording()
    with pytest.raises(NoImpulseError):
        pairs_of(events, *scene(taps_s=(1.2, 20.1)).recording()[1:])
    with pytest.raises(SaturatedImpulseError):
        pairs_of(*scene(limit=1.5, tap_s=0.03).recording())
    with pytest.raises(AlignmentError):
        pairs_of(events, t[:3], force[:3])
    pairs_of(events, np.delete(t, [100, 101]), np.delete(force, [100, 101]))
    with pytest.raises(GapError):
        pairs_of(events, np.where(t > t[0] + 2.0, t + 0.2, t), force)


def test_evenly_spaced_taps_missing_from_one_side_are_ambiguous(scene: Any, pairs_of: Any) -> None:
    case = scene(taps_s=(2.0, 12.0, 22.0), heights=(3.0, 3.0, 3.0), presses=False)
    events, t, force = case.recording()
    cut = t < case.reference_s(np.array(15.0))
    with pytest.raises(AmbiguousImpulsesError):
        pairs_of(events, t[cut], force[cut])


def test_a_recording_without_events_or_baseline_is_refused(trial: Any, recording_of: Any) -> None:
    recording = recording_of(trial)
    with pytest.raises(NoImpulseError):
        align(replace(recording, events=NO_EVENTS))
    with pytest.raises(ShortBaselineError):
        align(recording, replace(DEFAULTS, min_baseline=60.0))


EPOCH_US = 1_700_000_000_000_000


@given(
    gaps=st.lists(st.integers(20_000, 3_000_000), min_size=4, max_size=20, unique=True),
    drift=st.floats(-1e-4, 1e-4),
)
def test_edges_give_the_clocks_to_microseconds(gaps: list[int], drift: float) -> None:
    camera = EPOCH_US + np.cumsum([0, 2_000_000, *gaps])
    reference = 5.25 + (1.0 + drift) * (camera - EPOCH_US) * 1e-6
    fit = fit_edges(camera.astype(np.int64), reference)
    assert np.abs(fit.to_reference(camera) - reference).max() < 2e-6
    assert fit.method == 'hardware_edges'
    assert len(fit.anchors) == len(camera)


def test_edges_missing_on_one_side_are_left_out() -> None:
    rng = np.random.default_rng(3)
    camera = np.cumsum(rng.integers(50_000, 900_000, 30)).astype(np.int64)
    reference = 100.0 + camera * 1e-6
    fit = fit_edges(camera[2:], np.delete(reference, [5, 17])[:-3])
    assert abs(float(fit.to_reference(0)) - 100.0) < 1e-6
    assert len(fit.anchors) == 23
    # A repeated edge counts once.
    assert len(fit_edges(np.append(camera, camera[7]), reference).anchors) == 30


def test_even_edges_are_ambiguous_unless_all_are_known_to_be_there() -> None:
    camera, shifted = (np.arange(20) * 500_000).astype(np.int64), np.arange(20) * 0.5 - 0.5
    assert fit_edges(camera, shifted).to_reference(0) == pytest.approx(-0.5)
    for reference in (shifted, shifted[:-1]):
        with pytest.raises(AmbiguousImpulsesError):
            fit_edges(camera, reference, complete=False)


def test_edges_are_paired_by_their_arrival_only_where_that_is_certain() -> None:
    camera = 1_000_000_000 * np.arange(20)
    late = np.random.default_rng(5).integers(0, 30_000_000, 20)
    assert arrived_together(camera, camera + late)
    assert not arrived_together(camera, camera + 1_000_000_000)
    assert not arrived_together(camera[:-1], (camera + late)[1:])
    assert not arrived_together(camera[:-1], camera)
    assert not arrived_together(camera[:2], camera[:2])


def test_edges_that_make_no_map_are_refused() -> None:
    camera = np.array([0, 1_000_000, 2_500_000], np.int64)
    with pytest.raises(NoImpulseError):
        fit_edges(camera, np.array([1.0]))
    with pytest.raises(NoImpulseError):
        fit_edges(camera[:2], 5.0 + camera[:2] * 1e-6)
    with pytest.raises((NoImpulseError, DriftError)):
        fit_edges(camera, np.array([0.0, 1.3, 2.9]))
