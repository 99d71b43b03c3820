# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures of contacts from made-up trials, and the field of a simulated press against the truth."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mixtac_fger.config import FgerConfig
from mixtac_fger.contact import ContactFitter, contact_shape
from mixtac_fger.displacement import FieldMeter, SkinScale
from mixtac_fger.features import FramePreparation, mean_contrast
from mixtac_fger.mesh_scale import GEL_MM, by_mesh
from mixtac_lab.experiments.studies.contact_place import (
    FIRST_DEVICE,
    Touched,
    contact_rows,
    edge_delays,
    felt_place,
    px_per_mm,
)
from mixtac_sim.mechanics.contact import Mode
from mixtac_sim.world.device import draw_conditions
from mixtac_sim.world.effects import preset
from mixtac_sim.world.profiles import make_profile
from mixtac_sim.world.segments import Profile, Segment
from mixtac_sim.world.sensor import TactileSensor
from mixtac_sim.world.training_trials import TRAINING_DEVICES, UNSEEN


def test_delays_are_those_of_the_nearest_edge():
    end_us = np.arange(0, 3_000_000, 2000)
    force = np.where((end_us > 500_000) & (end_us < 1_500_000), 0.5, 0.0)
    touching = (end_us > 508_000) & (end_us < 1_496_000)
    places = np.where(touching[:, None], [1.2, 0.0], np.nan)
    area = np.where(touching, 11.0, np.nan)
    truth = np.array([1.0, 0.0])
    trial = Touched(end_us, force, touching, places, area, truth, np.full(len(end_us), 10.0))
    assert edge_delays(trial) == {True: [8.0], False: [-4.0]}
    rows = {row['what']: row['value'] for row in contact_rows([trial], [])}
    assert rows['place, from 0.1 N, median'] == pytest.approx(0.2)
    assert rows['area, median error'] == pytest.approx(0.1)
    assert rows['on, within 6 ms'] == 0.0
    assert rows['off, within 6 ms'] == 1.0
    assert rows['contacts given less true ones'] == 0


def test_a_reference_sensor_tells_where_a_pulled_contact_is():
    """2 mm to the right, 1 mm down; its clock is 3 s ahead and 1 % fast, its readings 5 ms late."""
    t_us = np.arange(0, 2_000_000, 1250)
    force, pull = np.where(t_us > 500_000, 0.5, 0.0), np.where(t_us > 1_000_000, 0.2, 0.0)
    nothing = np.zeros(len(t_us))
    wrench = np.stack([pull, nothing, force, 1e-3 * force, -2e-3 * force, nothing], axis=1)
    stamps_us = np.rint(1.01 * t_us + 3e6 + 5000.0).astype(np.int64)
    trial = SimpleNamespace(
        clock=(1.01, 3e6),
        reference_t_us=stamps_us,
        reference_delay_us=5000.0,
        reference_wrench=wrench,
    )
    found = felt_place(trial, np.array([300_000, 800_000, 1_200_000, 1_600_000]))
    assert np.isnan(found[:2]).all()
    assert found[2:] == pytest.approx(np.array([[2.0, -1.0]] * 2), abs=1e-3)


def test_its_sensors_are_unseen():
    assert min(abs(FIRST_DEVICE - each) for each in (TRAINING_DEVICES, UNSEEN)) > 100_000


@pytest.fixture(scope='module')
def pressed():
    """Return frames of a simulated press (free, then at 0.5 N), the lens, and its place."""
    level = preset('paper_like')
    segment = Segment(0.25, 0.6, Mode.FORCE, (0.0, 0.15), (0.0, 0.5))
    sensor = TactileSensor(941_000, 942_000, Profile('press', 0.6, (segment,)), preset=level)
    frames = [each.intensity for each in sensor.advance(600_000).frames]
    return frames, sensor.device.lens, draw_conditions(942_000, level).contact_mm


def test_a_simulated_press_is_found_where_it_is(pressed):
    frames, lens, (right, down) = pressed
    config = FgerConfig()
    preparation = FramePreparation(config)
    contrasts = [preparation.contrast(each).coarse for each in frames]
    reference = np.mean(contrasts[:5], axis=0).astype(np.float32)
    scale = SkinScale(px_per_mm(lens), 0.01, lens.centre_px)
    meter, fitter = FieldMeter(config), ContactFitter((config.width, config.height), scale)
    fits = [fitter.fit(meter.measure(reference, each)) for each in contrasts]
    assert not any(fit.seen for fit in fits[:5])
    found = contact_shape(fits[-1].parameters, fits[-1].covariance, scale, 9.0)
    error = np.hypot(found.x_mm - right, found.y_mm + down)
    assert error < 4.0 * found.deviation_mm
    assert found.major_mm < 1.5 * found.minor_mm


@pytest.mark.parametrize(
    ('device', 'name'), [(970_000, 'paper_like'), (970_001, 'paper_like'), (971_000, 'hard')]
)
def test_the_mesh_in_view_gives_the_scale_of_sensors(device, name):
    level, config = preset(name), FgerConfig()
    profile = make_profile('idle', 1, 2.0, preset=level)
    sensor = TactileSensor(device, device + 50, profile, preset=level)
    preparation = FramePreparation(config)
    frames = [frame.intensity for frame in sensor.advance(260_000).frames[:5]]
    shown = mean_contrast([preparation.contrast(frame).coarse for frame in frames])
    lens, size = sensor.device.lens, (config.width, config.height)
    true = px_per_mm(lens)
    given = SkinScale(mesh_mm=1.08, gel_mm=lens.thickness_mm)
    found = by_mesh(given, shown, config.frame_bin, size)
    assert found.deviation < 0.015
    assert found.px_per_mm == pytest.approx(true, rel=0.03)
    usual = by_mesh(SkinScale(mesh_mm=1.08), shown, config.frame_bin, size)
    assert 0.03 < usual.deviation < 0.05
    # What is unknown of the gel is a fifth of the way to the skin.
    assert usual.px_per_mm / true - 1.0 == pytest.approx(
        0.2 * (lens.thickness_mm / GEL_MM[0] - 1.0), abs=0.03
    )
