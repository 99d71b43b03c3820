# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The scale by the mesh in the picture: found to a hundredth, or not at all."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_fger.displacement import SkinScale, skin_scale
from mixtac_fger.mesh_scale import FOCAL_PX, INDEX, LEAST_LEAD, by_mesh, find_lattice

SIZE, AXIS, BIN, PITCH_MM = (346, 260), (172.5, 129.5), 4, 1.08


def picture(period_px, angle=0.4, wires=True, seed=1):
    """Return the log contrast of beads before a dark skin, behind wires of a grey in between."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(SIZE[0]) - AXIS[0], np.arange(SIZE[1]) - AXIS[1])
    light = np.full(x.shape, 0.05)
    for column, row in zip(rng.uniform(-170, 170, 250), rng.uniform(-130, 130, 250), strict=True):
        light = np.maximum(light, 0.4 * np.exp(-(((x - column) ** 2 + (y - row) ** 2) / 40.0)))
    if wires:
        for along in (np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x):
            off = np.abs((along + 3.0) % period_px - 0.5 * period_px)
            cover = np.clip(1.7 - 0.8 * off, 0.0, 1.0)
            light = light * (1.0 - cover) + 0.1 * cover
    light *= rng.normal(1.0, 0.01, light.shape)
    rows, columns = SIZE[1] // BIN, SIZE[0] // BIN
    cut = light[: rows * BIN, : columns * BIN].reshape(rows, BIN, columns, BIN)
    return np.log(cut.mean(axis=(1, 3))).astype(np.float32)


@pytest.mark.parametrize(('period', 'angle'), [(14.2, 0.4), (16.8, 1.3), (15.5, 0.02)])
def test_pitch_and_angle_of_a_mesh_are_found(period, angle):
    # No lens bends this picture; near the axis the mean lens does not matter much.
    found = find_lattice(picture(period, angle), BIN, AXIS)
    assert found.lead > LEAST_LEAD
    assert found.period_px == pytest.approx(period, rel=0.1)
    assert np.cos(4.0 * (found.angle_rad - angle)) > 0.9


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_beads_alone_are_no_mesh(seed):
    assert find_lattice(picture(15.0, wires=False, seed=seed), BIN, AXIS).lead < LEAST_LEAD
    given = SkinScale(mesh_mm=PITCH_MM)
    assert by_mesh(given, picture(15.0, wires=False, seed=seed), BIN, SIZE) == given
    flat = np.zeros((65, 86), np.float32)
    assert by_mesh(given, flat, BIN, SIZE) == given


def test_the_skin_is_farther_than_the_mesh_by_the_gel():
    shown = picture(15.0)
    period = find_lattice(shown, BIN, AXIS).period_px
    known = by_mesh(skin_scale(0.0, 185.0, AXIS, PITCH_MM, 4.0), shown, BIN, SIZE)
    assert 1.0 / known.px_per_mm == pytest.approx(PITCH_MM / period + 4.0 / (INDEX * 185.0))
    unknown = by_mesh(skin_scale(0.0, 0.0, AXIS, PITCH_MM), shown, BIN, SIZE)
    assert known.deviation < 0.012 < 0.03 < unknown.deviation < 0.05
    assert unknown.px_per_mm < period / PITCH_MM
    assert FOCAL_PX[0] == 185.0


def test_what_was_measured_or_has_no_mesh_stays():
    shown = picture(15.0)
    for given in (skin_scale(11.0, 185.0, AXIS, PITCH_MM), skin_scale(0.0, 185.0, AXIS)):
        assert by_mesh(given, shown, BIN, SIZE) == given
