# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Inertial samples in SI units."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_core.events.readings import inertial_samples


def raw(values, info):
    packed = np.array(values, '>i2').tobytes() + bytes([info])
    return np.frombuffer(packed, np.uint8).reshape(1, 15)


def sample(values, info, flips=(False, False, False), imu_type=2):
    return inertial_samples(np.array([1]), raw(values, info), flips, imu_type)


@pytest.mark.parametrize('scale', range(4))
def test_full_scales_of_acceleration_and_rotation(scale):
    got = sample([-32768, 16384, 0, 0, -32768, 16384, 0], 0xE0 | scale << 2 | scale)
    share = np.array([-1, 0.5, 0]) * 2**scale
    np.testing.assert_allclose(got.acceleration[0], share * 2 * 9.80665)
    np.testing.assert_allclose(got.angular_velocity[0], np.deg2rad(share * 250))


def test_flipped_axes_change_sign_without_overflow():
    flips = (True, False, True)
    got = sample([-32768, -32768, 5, 0, 7, 7, -32768], 0xE0, flips)
    assert (np.sign(got.acceleration[0]) == [1, -1, -1]).all()
    assert (np.sign(got.angular_velocity[0]) == [-1, 1, 1]).all()


@pytest.mark.parametrize(('imu_type', 'celsius'), [(1, 36.0), (2, 22.018)])
def test_temperature_depends_on_the_unit(imu_type, celsius):
    got = sample([0, 0, 0, 340, 0, 0, 0], 0xE0, imu_type=imu_type)
    assert got.temperature[0] == pytest.approx(celsius, abs=1e-3)


def test_groups_that_were_not_sent_are_nan():
    got = sample([1] * 7, 0x40)
    assert np.isnan(got.acceleration).all()
    assert np.isnan(got.temperature).all()
    assert np.isfinite(got.angular_velocity).all()
