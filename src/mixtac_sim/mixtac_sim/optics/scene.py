# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The scene and the lens before it: lamp, flicker, skin, mesh and beads, at rest and in motion.

Beads are blurred discs in a sum kept in fixed point, so removing a disc restores every bit of what
was there before: only beads that moved are redrawn, and no error grows. The pixels
(`mixtac_sim.pixels.dvs`) compute how the sum covers the background.

The light of the mesh is tabulated over its sag and blended between the tables, as its wires move by
less than their blur from one table to the next.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_core.events.arrays import Floats
from mixtac_sim.grids import (
    HEIGHT,
    PADDED,
    PITCH_MM,
    PIXELS,
    TILE,
    TILES,
    WIDTH,
    stream,
)

SILICONE_INDEX = 1.41
"""Refractive index of the layer: it looks shallower by this factor."""


@dataclass(frozen=True, slots=True)
class Lens:
    """A thin lens with radial distortion that looks through air at the mesh side of the layer.

    Attributes:
        focal_mm: Focal length [mm] (estimate).
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


@lru_cache(maxsize=2)
def pixel_slopes(lens: Lens) -> tuple[Floats, Floats]:
    """Return the slopes of the rays of all pixels, x and y [260, 346], distortion undone."""
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float64)
    bent_x = (columns - lens.centre_px[0]) / lens.image_distance_px
    bent_y = (rows - lens.centre_px[1]) / lens.image_distance_px
    bent = np.hypot(bent_x, bent_y)
    straight = bent.copy()
    for _ in range(20):
        square = straight**2
        straight = bent / (1.0 + lens.k1 * square + lens.k2 * square**2)
    stretch = straight / np.maximum(bent, 1e-12)
    cos, sin = np.cos(lens.roll_rad), np.sin(lens.roll_rad)
    turned_x, turned_y = bent_x * stretch, bent_y * stretch
    return cos * turned_x + sin * turned_y, cos * turned_y - sin * turned_x


DIAMETER_MM = 0.8
"""Diameter of the beads [mm] (paper, section 3.1)."""
EXTENT_MM = (17.0, 13.0)
"""Half width and height [mm] of the patch with beads, a little beyond the view."""


@dataclass(frozen=True, slots=True)
class Markers:
    """Beads at rest; x and y count from the optical axis, depth from the skin.

    Attributes:
        x_mm: Place to the right in the image [n] [mm].
        y_mm: Place downwards in the image [n] [mm].
        depth_mm: Depth of the centre below the skin [n] [mm].
        opacity: How strongly each bead covers what is behind it [n].
        diameter_mm: Diameter of the beads [mm].
    """

    x_mm: Floats
    y_mm: Floats
    depth_mm: Floats
    opacity: Floats
    diameter_mm: float = DIAMETER_MM


def scatter_markers(
    device_seed: int, thickness_mm: float, number: tuple[int, int], diameter_mm: float
) -> Markers:
    """Return the beads of a device: uniform in the layer, none inside another.

    Args:
        device_seed: Seed of the device.
        thickness_mm: Thickness of the layer [mm].
        number: Least and largest number of beads (estimate: 450 are about 5 % of the volume).
        diameter_mm: Diameter of the beads [mm]; their number and places do not depend on it.
    """
    few, many = number
    beads = int(stream(device_seed, 'number of markers').integers(few, many + 1))
    rng = stream(device_seed, 'markers')
    margin = 0.5 * DIAMETER_MM + 0.1
    low = np.array([-EXTENT_MM[0], -EXTENT_MM[1], margin])
    high = np.array([EXTENT_MM[0], EXTENT_MM[1], thickness_mm - margin])
    placed = np.empty((beads, 3))
    count = 0
    while count < beads:
        placed[count] = rng.uniform(low, high)
        count += _is_free(placed, count, DIAMETER_MM**2)
    opacity = rng.uniform(1.2, 3.0, size=beads)
    return Markers(placed[:, 0], placed[:, 1], placed[:, 2], opacity, diameter_mm)


@njit(cache=True)
def _is_free(placed: Floats, count: int, apart: float) -> bool:
    """Return whether a bead is far enough from those before it; square of the distance [mm2]."""
    x, y, z = placed[count]
    for other in range(count):
        across = (placed[other, 0] - x) ** 2 + (placed[other, 1] - y) ** 2
        if across + (placed[other, 2] - z) ** 2 <= apart:
            return False
    return True


MESH_PITCH_MM = 1.08
"""Aperture 0.9 mm and wire 0.18 mm (paper, section 3.1)."""
MESH_WIRE_MM = 0.18
"""Thickness of the wires [mm] (paper)."""
SAG_MM = 8.0
"""Radius of the mesh's sag [mm] (estimate)."""


@dataclass(frozen=True, slots=True)
class Lighting:
    """Light and reflectances of a device (all estimates).

    Attributes:
        lux: Illuminance of the array under a white scene on the axis [lx].
        tilt: Relative change of the light per 10 mm to the right and downwards.
        bowl: Relative change of the light at 10 mm from the axis.
        skin: Reflectance of the black skin.
        bead: Reflectance of a fully opaque bead.
        wire: Reflectance of the mesh.
        glare: Veiling glare as a reflectance.
        mesh_angle: Rotation of the mesh [rad].
        mesh_shift_mm: Shift of the mesh [mm].
        corner_px: Distance from the axis [px] where the lens's image circle begins to end.
        wire_mm: Thickness of the mesh's wires [mm]; 0 for no mesh in view.
    """

    lux: float
    tilt: tuple[float, float]
    bowl: float
    skin: float
    bead: float
    wire: float
    glare: float
    mesh_angle: float
    mesh_shift_mm: tuple[float, float]
    corner_px: float
    wire_mm: float = MESH_WIRE_MM


class Scene(NamedTuple):
    """Light on the array as floor + gain * cover, with cover = 0 (no bead) to 1 (all bead).

    Attributes:
        floor: Illuminance without beads [padded pixels] [lx], float32.
        gain: Change from no bead to bead [padded pixels] [lx], float32.
    """

    floor: NDArray[np.float32]
    gain: NDArray[np.float32]


def build_scene(
    lens: Lens,
    lighting: Lighting,
    contact_mm: tuple[float, float] = (0.0, 0.0),
    sag_mm: float = 0.0,
) -> Scene:
    """Return the light on the array.

    The mesh lies on the camera's side of the beads and hides them; under load it sags towards the
    camera.

    Args:
        lens: The lens.
        lighting: Light and mesh.
        contact_mm: Where the mesh sags most, from the optical axis [mm].
        sag_mm: Largest sag [mm].
    """
    slope_x, slope_y = pixel_slopes(lens)
    light = _light(lens, lighting, slope_x, slope_y)
    far = float(lens.distance_mm(lens.thickness_mm))
    away = np.hypot(far * slope_x - contact_mm[0], far * slope_y - contact_mm[1])
    sag = sag_mm * np.exp(-((away / SAG_MM) ** 2))
    open_share = _open_share(lens, lighting, slope_x, slope_y, sag)
    wires = lighting.wire * (1.0 - open_share)
    floor = light * (open_share * lighting.skin + wires) + lighting.lux * lighting.glare
    gain = light * open_share * (lighting.bead - lighting.skin)
    return Scene(_padded(floor), _padded(gain))


def _padded(image: Floats) -> NDArray[np.float32]:
    """Return an image as a flat array of whole tiles, repeated beyond its end."""
    flat = np.empty(PADDED, np.float32)
    flat[:PIXELS] = image.ravel()
    flat[PIXELS:] = flat[PIXELS - 1]
    return flat


def _light(lens: Lens, lighting: Lighting, slope_x: Floats, slope_y: Floats) -> Floats:
    """Return the light of a white scene [lx]: LEDs, cos^4 and the end of the image circle."""
    square = slope_x**2 + slope_y**2
    reach = 0.1 * float(lens.distance_mm(0.0))
    lamps = 1.0 + lighting.bowl * reach**2 * square
    lamps += reach * (lighting.tilt[0] * slope_x + lighting.tilt[1] * slope_y)
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    off_axis = np.hypot(columns - lens.centre_px[0], rows - lens.centre_px[1])
    circle = 1.0 / (1.0 + np.exp((off_axis - lighting.corner_px) / 9.0))
    return np.asarray(lighting.lux * np.maximum(lamps, 0.1) / (1.0 + square) ** 2 * circle)


def _open_share(
    lens: Lens, lighting: Lighting, slope_x: Floats, slope_y: Floats, sag_mm: Floats
) -> Floats:
    """Return the share of each pixel's view that the mesh leaves open."""
    distance = lens.distance_mm(lens.thickness_mm) - sag_mm
    blur = float(np.hypot(lens.softness_px, lens.blur_px(lens.thickness_mm)))
    blur_mm = blur * distance / lens.image_distance_px
    wire = lighting.wire_mm
    cos, sin = np.cos(lighting.mesh_angle), np.sin(lighting.mesh_angle)
    x = distance * (cos * slope_x + sin * slope_y) + lighting.mesh_shift_mm[0]
    y = distance * (cos * slope_y - sin * slope_x) + lighting.mesh_shift_mm[1]
    return (1.0 - _wire_cover(x, blur_mm, wire)) * (1.0 - _wire_cover(y, blur_mm, wire))


def _wire_cover(place_mm: Floats, blur_mm: Floats | float, wire_mm: float) -> Floats:
    """Return how much of a blur disc is covered by the nearest of a set of parallel wires."""
    off = np.abs((place_mm + 0.5 * MESH_PITCH_MM) % MESH_PITCH_MM - 0.5 * MESH_PITCH_MM)
    far = np.minimum(off + 0.5 * blur_mm, 0.5 * wire_mm)
    near = np.maximum(off - 0.5 * blur_mm, -0.5 * wire_mm)
    return np.clip((far - near) / blur_mm, 0.0, 1.0)


class Flicker(NamedTuple):
    """A ripple of the light about a mean of 1, too small to make a pixel fire without motion.

    Compiled code reads it as well.

    Attributes:
        depth: Peak of the ripple over the mean, less 1: up to 0.05. A swing of 0.1 log-e is below
            every threshold and only shifts the time of other crossings; 0 is steady light.
        phase: Phase at time 0 [turns].
        hz: Frequency [Hz]: twice the mains'.
    """

    depth: float
    phase: float
    hz: float = 100.0

    def mean(self, start_us: float, end_us: float) -> float:
        """Return the mean light between two times [us], for an exposure; 1 if steady."""
        if self.depth <= 0.0:
            return 1.0
        edges_us = np.linspace(start_us, end_us, 513)
        turns = 1e-6 * (0.5 * (edges_us[1:] + edges_us[:-1])) * self.hz + self.phase
        return float(np.mean(1.0 + self.depth * np.sin(2.0 * np.pi * turns)))


ONE = 65536
"""Fixed-point one of the sum."""
TOLERANCE_PX = 0.01
"""Motion or growth below this is not drawn: it changes no log intensity by more than 1 %."""


class Renderer:
    """The sum of all bead images.

    Args:
        opacity: Optical thickness of each bead [n].

    Attributes:
        cover: Optical thickness times ``ONE`` [padded pixels], int32.
        dirty: Tiles in which ``cover`` changed since they were last cleared [tiles], uint8.
    """

    def __init__(self, opacity: Floats) -> None:
        self.cover = np.zeros(PADDED, np.int32)
        self.dirty = np.ones(TILES, np.uint8)
        self._opacity = opacity
        self._drawn = np.zeros((len(opacity), 4))  # radius 0: nothing is there yet

    def draw(self, spots: Floats) -> None:
        """Show beads at new places.

        Args:
            spots: Column, row, radius and edge width of each bead [n, 4] [px].
        """
        _redraw(self.cover, self.dirty, self._drawn, spots, self._opacity)


@njit(cache=True, nogil=True, error_model='numpy')
def _redraw(
    cover: NDArray[np.int32],
    dirty: NDArray[np.uint8],
    drawn: Floats,
    spots: Floats,
    opacity: Floats,
) -> None:
    """Remove and redraw the discs that moved."""
    for i in range(spots.shape[0]):
        moved = abs(spots[i, 0] - drawn[i, 0]) + abs(spots[i, 1] - drawn[i, 1])
        grown = abs(spots[i, 2] - drawn[i, 2]) + 0.5 * abs(spots[i, 3] - drawn[i, 3])
        if moved + grown < TOLERANCE_PX:
            continue
        if drawn[i, 2] > 0.0:
            _splat(cover, dirty, drawn[i], -opacity[i] * ONE)
        _splat(cover, dirty, spots[i], opacity[i] * ONE)
        for k in range(spots.shape[1]):
            drawn[i, k] = spots[i, k]


@njit(cache=True, nogil=True, error_model='numpy')
def _splat(cover: NDArray[np.int32], dirty: NDArray[np.uint8], spot: Floats, height: float) -> None:
    """Add one disc with a smooth edge, darker towards its limb as a lit ball is."""
    x, y = np.float32(spot[0]), np.float32(spot[1])
    outer = np.float32(spot[2] + 0.5 * spot[3])
    per_width, per_radius = np.float32(1.0 / spot[3]), np.float32(0.25 / spot[2] ** 2)
    peak = np.float32(height)
    first_row, last_row = max(int(np.ceil(y - outer)), 0), min(int(y + outer), HEIGHT - 1)
    left, right = max(int(np.ceil(x - outer)), 0), min(int(x + outer), WIDTH - 1)
    if first_row > last_row or left > right:
        return
    for row in range(first_row, last_row + 1):
        base = row * WIDTH
        dy = (row - y) * (row - y)
        for column in range(left, right + 1):
            square = (column - x) * (column - x) + dy
            ramp = (outer - np.sqrt(square)) * per_width
            ramp = min(max(ramp, np.float32(0.0)), np.float32(1.0))
            edge = ramp * ramp * (np.float32(3.0) - np.float32(2.0) * ramp)
            limb = max(np.float32(1.0) - per_radius * square, np.float32(0.4))
            cover[base + column] += np.int32(peak * edge * limb)
        for tile in range((base + left) // TILE, (base + right) // TILE + 1):
            dirty[tile] = 1


LEVELS_MM = np.linspace(0.0, 0.6, 13)
"""Sags of the tables [mm]; 0.6 mm are 1 to 6 N. A mesh that sags more is shown like that."""
TOLERANCE_MM = 0.002
"""Motion below this is not shown: it changes no log intensity by more than 0.5 %."""
VISIBLE = 0.02
"""Relative change of the light below which a tile is left alone."""


class MeshMotion:
    """Light on the array behind a mesh that sags.

    Args:
        lens: The lens.
        lighting: Light and mesh.
        mesh_n_per_mm: Stiffness of the mesh [N/mm].
        contact_mm: Where it is pressed, from the optical axis [mm].

    Attributes:
        floors: Light without beads at each of `LEVELS_MM` [level, tile, 64] [lx].
        gains: Change from no bead to bead [level, tile, 64] [lx].
        tiles: Tiles in which the mesh can be seen to move [n].
    """

    def __init__(
        self,
        lens: Lens,
        lighting: Lighting,
        mesh_n_per_mm: float,
        contact_mm: tuple[float, float],
    ) -> None:
        scenes = [build_scene(lens, lighting, contact_mm, sag_mm) for sag_mm in LEVELS_MM]
        self.floors = np.stack([scene.floor.reshape(TILES, TILE) for scene in scenes])
        self.gains = np.stack([scene.gain.reshape(TILES, TILE) for scene in scenes])
        change = np.abs(self.floors[-1] / self.floors[0] - 1.0).max(axis=1)
        self.tiles: NDArray[np.int64] = np.flatnonzero(change > VISIBLE).astype(np.int64)
        self._per_n = 1.0 / mesh_n_per_mm
        self._shown_mm = 0.0

    def level(self, elastic_n: float) -> float | None:
        """Return the place among the levels under an elastic force [N], None if as shown before."""
        sag = min(elastic_n * self._per_n, float(LEVELS_MM[-1]))
        if abs(sag - self._shown_mm) < TOLERANCE_MM:
            return None
        self._shown_mm = sag
        return sag / float(LEVELS_MM[1])
