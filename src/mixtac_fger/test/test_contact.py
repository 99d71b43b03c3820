# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Displacement fields of moved textures, contacts in fields of known ones, and their tracking."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_fger.config import FgerConfig
from mixtac_fger.contact import Touch, TouchMeter, contact_shape
from mixtac_fger.contact_tracking import ContactSettings, ContactTracker, FlowCarrier
from mixtac_fger.displacement import DisplacementField, FieldMeter, SkinScale, field_places

CONFIG = FgerConfig()
SIZE = CONFIG.width, CONFIG.height
SCALE = SkinScale(12.0, 0.0)
ROWS, COLUMNS = CONFIG.frame_shape[0] // 2, CONFIG.frame_shape[1] // 2
GRID = CONFIG.grid_rows, CONFIG.grid_columns
PLACES = field_places((ROWS, COLUMNS), 8, SCALE, SIZE)
FEW = settings(max_examples=12)
ALONG = st.floats(-6.0, 6.0)


def pressed(place, widths=(3.0, 3.0), angle=0.0, strength=0.4, shear=(0.0, 0.0), noise=0.0):
    """Return the field [px] of a contact in the contact frame, y upwards."""
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    matrix = turn @ np.diag([1.0 / widths[0] ** 2, 1.0 / widths[1] ** 2]) @ turn.T
    away = PLACES - np.array(place)[:, None, None]
    driven = np.einsum('ij,jrc->irc', matrix, away)
    square = np.sum(away * driven, axis=0)
    ahead = np.einsum('i,irc->rc', np.array(shear), away)
    fall = 1.0 + 0.8 * square
    moved = driven * (strength * (1.0 + square) ** -1.5 + 0.64 * ahead * fall**-2.5)
    moved += np.array(shear)[:, None, None] * fall**-1.5
    moved += noise * np.random.default_rng(0).normal(size=moved.shape)
    moved *= np.array([12.0, -12.0])[:, None, None]
    tensor = np.full((3, ROWS, COLUMNS), 1e-3, np.float32)
    tensor[1] = 0.0
    return DisplacementField(moved.astype(np.float32), tensor, 0.02, 8, 4)


@FEW
@given(x=ALONG, y=ALONG, shear=st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)))
def test_place_and_width_of_a_contact_are_found_with_any_shear(x, y, shear):
    fit = TouchMeter(CONFIG, SCALE).fit(pressed((x, y), shear=shear))
    found = contact_shape(fit.parameters, fit.covariance, SCALE, 9.0)
    assert fit.seen
    assert (found.x_mm, found.y_mm) == pytest.approx((x, y), abs=0.02)
    assert fit.parameters[5] == pytest.approx(3.0**-2, rel=0.02)
    assert found.major_mm * found.minor_mm * math.pi == pytest.approx(found.area_mm2)


def test_the_place_of_a_pulled_contact_is_less_certain():
    deviations = []
    for pull in (0.0, 0.05, 0.1):
        fit = TouchMeter(CONFIG, SCALE).fit(pressed((1.0, 2.0), shear=(pull, 0.0)))
        shape = contact_shape(fit.parameters, fit.covariance, SCALE, 9.0)
        deviations.append(shape.deviation_mm)
    assert deviations[0] < deviations[1] < deviations[2]


def test_noise_and_a_picture_without_texture_show_no_contact():
    noise = pressed((0.0, 0.0), strength=0.0, noise=0.01)
    assert not TouchMeter(CONFIG, SCALE).fit(noise).seen
    # As behind a lens cap, or without a lamp.
    nothing = DisplacementField(
        np.zeros((2, ROWS, COLUMNS), np.float32),
        np.zeros((3, ROWS, COLUMNS), np.float32),
        *(0.0, 8, 4),
    )
    fit = TouchMeter(CONFIG, SCALE).fit(nothing)
    assert not fit.seen
    assert np.isfinite(fit.gains).all()


@FEW
@given(angle=st.floats(-1.5, 1.5))
def test_an_oblong_contact_lies_where_its_longer_axis_points(angle):
    fit = TouchMeter(CONFIG, SCALE).fit(pressed((1.0, -1.0), widths=(4.0, 2.5), angle=angle))
    found = contact_shape(fit.parameters, fit.covariance, SCALE, 0.0)
    assert math.cos(2.0 * (found.angle - angle)) > 0.99
    assert found.major_mm / found.minor_mm == pytest.approx(1.6, rel=0.1)


def test_displacement_of_a_moved_texture_is_measured_beyond_one_bin():
    rows, columns = CONFIG.frame_shape
    row, column = np.mgrid[0:rows, 0:columns].astype(np.float64)

    def texture(x, y):
        waves = np.random.default_rng(1).normal(0.0, 0.4, (40, 3))
        return sum(0.1 * np.sin(a * x + b * y + 9.0 * c) for a, b, c in waves)

    # 1.2 bins to the right and half a bin up: 4.8 and -2 px.
    reference, image = texture(column, row), texture(column - 1.2, row + 0.5)
    field = FieldMeter(CONFIG).measure(reference.astype(np.float32), image.astype(np.float32))
    inner = field.moved[:, 3:-3, 3:-3]
    assert np.median(inner[0]) == pytest.approx(4.8, abs=0.15)
    assert np.median(inner[1]) == pytest.approx(-2.0, abs=0.15)
    assert np.all(field.confidence() <= 1.0)
    blank = np.zeros((rows, columns), np.float32)
    assert np.all(np.isfinite(FieldMeter(CONFIG).measure(blank, blank).moved))


STILL = np.zeros((*GRID, 2), np.float32)
"""Flow of a window without motion."""


def touch_at(x, y):
    field = pressed((x, y))
    return Touch(field, TouchMeter(CONFIG, SCALE).fit(field))


def cell_flow(before, after, threshold):
    """Return the flow that events measure between two fields, per threshold."""
    change = DisplacementField(after.moved - before.moved, after.tensor, after.noise, 8, 4)
    rows = np.arange(ROWS) * GRID[0] // ROWS
    columns = np.arange(COLUMNS) * GRID[1] // COLUMNS
    flow = np.zeros((*GRID, 2), np.float32)
    count = np.zeros(GRID)
    np.add.at(count, (rows[:, None], columns[None]), 1.0)
    for axis in range(2):
        np.add.at(flow[..., axis], (rows[:, None], columns[None]), change.moved[axis])
    return flow / count[..., None].astype(np.float32) / threshold


def test_events_carry_place_and_displacement_between_frames():
    tracker = ContactTracker(ContactSettings(scale=SCALE), GRID)
    before, after = touch_at(0.0, 0.0), touch_at(0.4, -0.2)
    tracker.frame(10_000, before)
    still = tracker.window(12_000, 0.5, STILL)
    moved = tracker.window(14_000, 0.5, cell_flow(before.field, after.field, 0.25))
    assert still.shape.x_mm == pytest.approx(0.0, abs=0.02)
    assert moved.shape.x_mm == pytest.approx(0.4, abs=0.15)
    assert moved.shape.y_mm == pytest.approx(-0.2, abs=0.1)
    tracker.clear()
    tracker.frame(10_000, before)
    deeper = pressed((0.0, 0.0), strength=0.8)
    tracker.window(12_000, 0.5, cell_flow(before.field, deeper, 0.25))
    error = np.abs(tracker.moved() - deeper.moved).mean()
    assert error < 0.5 * np.abs(before.field.moved - deeper.moved).mean()


def test_frames_tell_the_size_of_a_contrast_threshold():
    carrier, fields = FlowCarrier(GRID), [pressed((0.0, 0.0), strength=s) for s in (0.0, 0.8)]
    carrier.frame(carrier.until(0), fields[0])
    for index in range(40):
        before, after = fields[index % 2], fields[(index + 1) % 2]
        carrier.window(4000 * index + 2000, cell_flow(before, after, 0.4))
        carrier.frame(carrier.until(4000 * (index + 1)), after)
    assert carrier.threshold == pytest.approx(0.4, rel=0.15)


def touching(tracker, forces, start_us=0) -> list[bool]:
    """Return the state after each of some windows."""
    return [
        tracker.window(start_us + 2000 * i, force, STILL).touching for i, force in enumerate(forces)
    ]


def test_contact_switches_with_hysteresis_and_has_no_place_before_a_frame():
    tracker = ContactTracker(ContactSettings(0.03, 0.02, scale=SCALE), GRID)
    assert touching(tracker, [0.0, 0.2]) == [False, True]
    assert all(touching(tracker, [*np.linspace(0.2, 0.027, 100), *[0.027] * 20], 4000))
    assert tracker.window(244_000, 0.027, STILL).shape is None
    assert not touching(tracker, [0.015] * 8, 246_000)[-1]


def test_a_light_force_has_to_last_and_to_show_in_the_picture():
    tracker = ContactTracker(ContactSettings(0.03, 0.02, scale=SCALE), GRID)
    assert not any(touching(tracker, [0.0] + [0.035] * 3 + [0.0] * 5))
    assert touching(tracker, [0.035] * 20, 40_000)[-1]
    tracker.clear()
    free = pressed((0.0, 0.0), strength=0.0, noise=0.01)
    tracker.frame(1000, Touch(free, TouchMeter(CONFIG, SCALE).fit(free)))
    # Noise moved the estimate: what frames show stays as it was.
    assert not any(touching(tracker, [0.0] + [0.06] * 40, 2000))
    tracker.frame(84_000, touch_at(0.0, 0.0))
    assert touching(tracker, [0.06], 86_000) == [True]


def test_noise_leaves_the_size_of_a_contrast_threshold_alone():
    random, carrier = np.random.default_rng(0), FlowCarrier(GRID)
    before, free = carrier.threshold, pressed((0.0, 0.0), strength=0.0, noise=0.001)
    for index in range(500):
        carrier.window(4000 * index + 2000, random.normal(0.0, 0.01, (*GRID, 2)))
        carrier.frame(carrier.until(4000 * (index + 1)), free)
    assert carrier.threshold == pytest.approx(before, rel=0.1)


def test_what_frames_correct_does_not_end_a_young_contact():
    tracker = ContactTracker(ContactSettings(0.03, 0.02, scale=SCALE), GRID)
    corrected = [0.0, 0.2, 0.1, 0.1, *np.linspace(0.09, 0.03, 5), 0.03, 0.035]
    assert all(touching(tracker, corrected)[1:])
    # The same fall is a release later.
    assert all(touching(tracker, [0.1] * 40, 22_000))
    assert not all(touching(tracker, corrected[3:], 102_000))


def test_a_release_is_told_before_the_estimate_has_fallen_and_leaves_no_new_contact():
    tracker = ContactTracker(ContactSettings(0.03, 0.02, scale=SCALE), GRID)
    fall = np.concatenate([np.full(20, 0.3), np.linspace(0.3, 0.05, 25), np.full(60, 0.05)])
    found = touching(tracker, [0.0, *fall])
    assert all(found[1:30])
    assert not any(found[46:])
    assert touching(tracker, [0.05 + 0.2], 500_000) == [True]


def test_an_estimate_that_comes_back_from_below_zero_is_no_new_contact():
    tracker = ContactTracker(ContactSettings(0.03, 0.02, scale=SCALE), GRID)
    bounce = [0.0, 1.0, 2.0, 1.0, -0.3, -0.2, -0.1, *[0.0] * 20]
    assert touching(tracker, bounce) == [False, *[True] * 3, *[False] * 23]
    assert touching(tracker, [0.2], 60_000) == [True]


def test_what_is_left_of_a_release_ends_with_a_picture_without_contact():
    tracker = ContactTracker(ContactSettings(0.03, 0.02, scale=SCALE), GRID)
    free = pressed((0.0, 0.0), strength=0.0, noise=0.01)
    unseen = Touch(free, TouchMeter(CONFIG, SCALE).fit(free))
    assert tracker.window(2000, 0.2, STILL).touching
    # Exposed too early to count.
    tracker.frame(3000, unseen)
    assert tracker.window(60_000, 0.06, STILL).touching
    tracker.frame(59_000, unseen)
    assert not tracker.window(62_000, 0.06, STILL).touching
    assert tracker.window(64_000, 0.25, STILL).touching
