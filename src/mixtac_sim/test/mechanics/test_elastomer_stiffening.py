# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Stiffening at large strain: none where strains are small, bounded where they are large."""

import numpy as np
import pytest

from mixtac_sim.mechanics.elastomer import HEMISPHERE, Layer, force_law
from mixtac_sim.world.device import draw_device

LAYER = Layer(180.0, 4.0)


@pytest.mark.parametrize('stiffening', [0.5, 3.0])
def test_small_strains_stay_linear(stiffening):
    linear, stiff = force_law(LAYER, HEMISPHERE), force_law(LAYER, HEMISPHERE, np.inf, stiffening)
    for depth in (0.1, 0.25, 0.4):  # up to 10 % of the thickness
        assert stiff.force_at(depth) == pytest.approx(linear.force_at(depth), rel=0.031)


@pytest.mark.parametrize('stiffening', [0.5, 3.0])
def test_large_strains_stay_below_those_of_rubber_in_compression(stiffening):
    # A neo-Hookean block has (1 / l^2 - l) / (3 (1 - l)) times the linear stress, l = 1 - strain.
    linear, stiff = force_law(LAYER, HEMISPHERE), force_law(LAYER, HEMISPHERE, np.inf, stiffening)
    for strain in (0.2, 0.3, 0.4):
        depth, left = 4.0 * strain, 1.0 - strain
        gain = stiff.force_at(depth) / linear.force_at(depth)
        assert gain == pytest.approx(1.0 + stiffening * strain**2, rel=0.01)
        assert gain < (left**-2 - left) / (3.0 * strain)


def test_same_dent_moves_beads_alike():
    device = draw_device(5)
    linear = force_law(device.layer, HEMISPHERE)
    stiff = force_law(device.layer, HEMISPHERE, np.inf, 2.0)
    depth = linear.depth_at(1.0)

    def moved(law):
        beads = device.beads(device.layer, (0.0, 0.0), (HEMISPHERE,), [law])
        rest = beads.place(0, 0.0, (0.0, 0.0)).copy()
        return beads.place(0, law.force_at(depth), (0.0, 0.0)) - rest

    # Only the mesh, which feels the force, moves more.
    sag = stiff.force_at(depth) / linear.force_at(depth) - 1.0
    np.testing.assert_allclose(moved(stiff)[:, :2], moved(linear)[:, :2], atol=0.02 + 2.0 * sag)
