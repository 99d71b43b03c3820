# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The wide-angle lens: where a point of the layer appears, how large and how blurred."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixtac_events.arrays import Floats
from mixtac_sim.grids import HEIGHT, PITCH_MM, WIDTH

SILICONE_INDEX = 1.41
"""Refractive index of the layer: it looks shallower by this factor."""


@dataclass(frozen=True, slots=True)
class Lens:
    """A thin lens with radial distortion that looks through air at the mesh side of the layer.

    Attributes:
        focal_mm: Focal length [mm]; 2.8 in the paper.
        f_number: Focal length over aperture; not stated, 1.8 to 2.8 (estimate).
        gap_mm: From the lens to the mesh side of the layer [mm] (estimate).
        thickness_mm: Thickness of the layer [mm].
        focus_depth_mm: Depth below the skin that is in focus [mm].
        k1: Radial distortion of second order (estimate).
        k2: Radial distortion of fourth order (estimate).
        centre_px: Column and row of the optical axis.
        softness_px: Edge width of a point in focus [px], lens and pixel together (estimate).
        index: Refractive index of the layer.
        roll_rad: Rotation of the camera about its axis [rad].
    """

    focal_mm: float
    f_number: float
    gap_mm: float
    thickness_mm: float
    focus_depth_mm: float
    k1: float
    k2: float
    centre_px: tuple[float, float]
    softness_px: float = 1.5
    index: float = SILICONE_INDEX
    roll_rad: float = 0.0

    def distance_mm(self, depth_mm: Floats | float) -> Floats:
        """Return the apparent distance [mm] of a depth below the skin, refraction included."""
        return np.asarray(self.gap_mm + (self.thickness_mm - depth_mm) / self.index)

    @property
    def magnification(self) -> float:
        """Return the magnification in focus."""
        return self.focal_mm / (float(self.distance_mm(self.focus_depth_mm)) - self.focal_mm)

    @property
    def image_distance_px(self) -> float:
        """Return the distance from lens to array [px]: pixels per unit of slope on the axis."""
        return self.focal_mm * (1.0 + self.magnification) / PITCH_MM

    def blur_px(self, depth_mm: Floats | float) -> Floats:
        """Return the diameter of the circle of confusion [px] at a depth below the skin."""
        distance = self.distance_mm(depth_mm)
        focus = self.distance_mm(self.focus_depth_mm)
        aperture = self.focal_mm / self.f_number
        return np.asarray(
            aperture * self.magnification * np.abs(distance - focus) / distance / PITCH_MM
        )

    def project(self, x_mm: Floats, y_mm: Floats, depth_mm: Floats) -> tuple[Floats, Floats]:
        """Return column and row [px] of points of the layer."""
        distance = self.distance_mm(depth_mm)
        cos, sin = np.cos(self.roll_rad), np.sin(self.roll_rad)
        slope_x = (cos * x_mm - sin * y_mm) / distance
        slope_y = (sin * x_mm + cos * y_mm) / distance
        square = slope_x**2 + slope_y**2
        gain = self.image_distance_px * (1.0 + self.k1 * square + self.k2 * square**2)
        return self.centre_px[0] + gain * slope_x, self.centre_px[1] + gain * slope_y

    def pixel_slopes(self) -> tuple[Floats, Floats]:
        """Return the slopes of the rays of all pixels, x and y [260, 346], distortion undone."""
        rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float64)
        bent_x = (columns - self.centre_px[0]) / self.image_distance_px
        bent_y = (rows - self.centre_px[1]) / self.image_distance_px
        bent = np.hypot(bent_x, bent_y)
        straight = bent.copy()
        for _ in range(20):
            square = straight**2
            straight = bent / (1.0 + self.k1 * square + self.k2 * square**2)
        stretch = straight / np.maximum(bent, 1e-12)
        cos, sin = np.cos(self.roll_rad), np.sin(self.roll_rad)
        turned_x, turned_y = bent_x * stretch, bent_y * stretch
        return cos * turned_x + sin * turned_y, cos * turned_y - sin * turned_x
