# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Images of the beads for a state of the contact.

Each bead's displacement is tabulated once per trial and indenter over the square root of the
elastic force, in which it is nearly quadratic; a step then costs one interpolation per bead.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numba import njit

from mixtac_core.events.arrays import Floats
from mixtac_sim.grids import PITCH_MM
from mixtac_sim.mechanics.elastomer import ForceLaw, Indenter, Layer, sheared_area
from mixtac_sim.mechanics.layer import displacement_field, shear_field, solve_edge
from mixtac_sim.optics.scene import SAG_MM, Lens, Markers

ROWS = 193
"""Rows of the displacement tables."""
AS_SHEAR = np.empty(0)
"""All beads follow the same displacement of the skin."""


class BeadMotion:
    """Images of the beads of a sensor under its contact.

    Args:
        beads: The beads at rest.
        lens: The lens.
        mesh_n_per_mm: Stiffness of the mesh [N/mm].
        layer: The layer on the day of the trial.
        contact_mm: Where the contact is, from the optical axis [mm].
        indenters: The indenters of the trial.
        laws: Force law of each indenter.
    """

    def __init__(
        self,
        beads: Markers,
        lens: Lens,
        mesh_n_per_mm: float,
        layer: Layer,
        contact_mm: tuple[float, float],
        indenters: Sequence[Indenter],
        laws: Sequence[ForceLaw],
    ) -> None:
        self._lens = lens
        self._rest = np.stack([beads.x_mm, beads.y_mm, beads.depth_mm])
        away = self._rest[:2] - np.array(contact_mm)[:, None]
        self._axis_mm = np.hypot(*away)
        self._direction = away / np.maximum(self._axis_mm, 1e-9)
        self._tops = np.array([law.force_n[-1] for law in laws])
        self._tables = np.stack(
            [
                self._table(layer, mesh_n_per_mm, tool, law)
                for tool, law in zip(indenters, laws, strict=True)
            ]
        )
        self._optics = _optics_row(lens, beads.diameter_mm)
        self._reach = np.stack([self._largest(table) for table in self._tables])
        self.spots = np.empty((len(beads.x_mm), 4))

    def _table(self, layer: Layer, mesh_n_per_mm: float, tool: Indenter, law: ForceLaw) -> Floats:
        """Return how each bead moves [row, bead, 9].

        The first three columns are its displacement by the indenter [mm], z towards the mesh; the
        others belong to a displacement (u, v) of the skin: x by u, x by v and y by u, y by v, z by
        u, z by v, and the share of a turn.
        """
        force = law.force_n[-1] * np.linspace(0.0, 1.0, ROWS) ** 2
        height = 1.0 - self._rest[2] / layer.thickness_mm
        alpha = law.radius_at(force)[:, None] / layer.thickness_mm
        follow = self._follow(alpha, height, layer.thickness_mm)
        sag = np.exp(-((self._axis_mm / SAG_MM) ** 2)) * force[:, None] / mesh_n_per_mm
        if tool.shape == 'edge':
            table = self._edge_table(layer, tool, law.linear_at(force))
            table[:, :, 2] += sag
            return np.concatenate([table, follow], axis=-1)
        field = displacement_field(tool.shape).at(alpha, height, self._axis_mm / layer.thickness_mm)
        inward, outward = np.moveaxis(field, -1, 0)
        linear = law.linear_at(force)[:, None]
        scale = linear / (1e-3 * layer.modulus_kpa * layer.thickness_mm)
        radial = scale * outward
        pressed = np.stack([*(radial * d for d in self._direction), scale * inward + sag], axis=-1)
        return np.concatenate([pressed, follow], axis=-1)

    def _follow(self, alpha: Floats, height: Floats, thickness_mm: float) -> Floats:
        """Return how beads follow the skin under contacts of radius over thickness [row, bead, 6].

        The pull is that of `Shear` for a displacement of the skin, and moves the layer as it does.
        """
        found = shear_field().at(alpha, height, self._axis_mm / thickness_mm)
        x, y = self._direction
        # The pull of a displacement of 1, in the unit of the field.
        pull = sheared_area(alpha, 1.0) / (2.0 * np.pi)
        along, lobes, rise = np.moveaxis(found[..., :3], -1, 0) * pull
        lengthwise, aside = lobes * (x * x - y * y), lobes * 2.0 * x * y
        moved = (along + lengthwise, aside, along - lengthwise, -rise * x, -rise * y)
        return np.stack([*moved, found[..., 3]], axis=-1)

    def _edge_table(self, layer: Layer, tool: Indenter, linear_n: Floats) -> Floats:
        """Return the displacements under an edge without the mesh's sag [row, bead, xyz] [mm]."""
        contact = solve_edge(tool.radius_mm, tool.length_mm, layer.thickness_mm)
        away = self._axis_mm * self._direction
        height = 1.0 - self._rest[2] / layer.thickness_mm
        solved = contact.displacements(away[0], away[1], height)
        rows = np.interp(linear_n / layer.modulus_kpa, contact.force_n, np.arange(len(solved)))
        low = np.minimum(rows.astype(np.int64), len(solved) - 2)
        part = (rows - low)[:, None, None]
        return np.asarray((1.0 - part) * solved[low] + part * solved[low + 1])

    def _largest(self, table: Floats) -> Floats:
        """Return the largest displacement in the image [px] of any bead, per row of a table."""
        column, row = self._lens.project(*self._rest)
        places = self._rest[:, None] + np.moveaxis(table[..., :3], -1, 0)
        moved_column, moved_row = self._lens.project(*places)
        return np.asarray(np.hypot(moved_column - column, moved_row - row).max(axis=1))

    @property
    def px_per_mm(self) -> float:
        """Return the scale of the image at the skin, on the axis [px/mm]."""
        return self._lens.image_distance_px / float(self._lens.distance_mm(0.0))

    def row_of(self, indenter: int, elastic_n: Floats) -> Floats:
        """Return the place in the table of elastic forces [N]."""
        share = np.clip(np.asarray(elastic_n) / self._tops[indenter], 0.0, 1.0)
        return np.asarray((ROWS - 1) * np.sqrt(share))

    def reach_px(self, indenter: int, elastic_n: Floats) -> Floats:
        """Return the largest displacement of any bead [px] under elastic forces [N]."""
        row = self.row_of(indenter, elastic_n)
        return np.asarray(np.interp(row, np.arange(ROWS), self._reach[indenter]))

    def place(
        self,
        indenter: int,
        elastic_n: float,
        shear: tuple[float, float],
        own: tuple[Floats, Floats] = (AS_SHEAR, AS_SHEAR),
    ) -> Floats:
        """Return the images of all beads: column, row, radius, edge width [n, 4] [px].

        The array is reused by the next call.

        Args:
            indenter: Number of the indenter.
            elastic_n: Elastic force [N].
            shear: Shear displacement of the skin, right and down [mm].
            own: Factors of the shear, a displacement of the skin per bead instead [n], and what is
                added to the displacement of each bead, in units of the shear [n].
        """
        row = float(self.row_of(indenter, np.array(elastic_n)))
        _place(self._tables[indenter], row, *shear, *own, self._rest, self._optics, self.spots)
        return self.spots

    def rows(self, row: float) -> Floats:
        """Return the two rows of the first table about a place [2, n, 9]."""
        low = min(int(row), ROWS - 2)
        return np.asarray(self._tables[0, low : low + 2])

    def place_turned(
        self,
        rows: Floats,
        part: float,
        shear: tuple[float, float],
        turn: tuple[float, tuple[float, float]],
    ) -> Floats:
        """Return the images of all beads between two rows of a table; see `place`.

        Args:
            rows: Two rows [2, n, 9].
            part: Share of the second row.
            shear: Shear displacement of the skin, right and down [mm].
            turn: Turn of the skin [rad], and its centre from the optical axis [mm].
        """
        angle, (x, y) = turn
        rest, share = self._rest.copy(), (1.0 - part) * rows[0, :, 8] + part * rows[1, :, 8]
        rest[0] -= angle * share * (self._rest[1] - y)
        rest[1] += angle * share * (self._rest[0] - x)
        _place(rows, part, *shear, AS_SHEAR, AS_SHEAR, rest, self._optics, self.spots)
        return self.spots


GRID_MM = 1.0
"""Distance of the places for which the motion of the beads is computed [mm]."""


class SlidingBeads:
    """Images of the beads under a contact that slides over the skin.

    Between places on a grid of 1 mm, displacements are interpolated; each place takes a
    fraction of a second, once.

    Args:
        at: Makes the motion of the beads under one indenter, by its number, in contact at a place
            from the optical axis [mm].
        contact_mm: The first contact, from the optical axis [mm].
    """

    def __init__(
        self, at: Callable[[int, tuple[float, float]], BeadMotion], contact_mm: tuple[float, float]
    ) -> None:
        self._at, self._contact_mm = at, contact_mm
        self._found: dict[tuple[int, int, int], BeadMotion] = {}

    def place(
        self,
        indenter: int,
        elastic_n: float,
        shear: tuple[float, float],
        turn_rad: float,
        place_mm: tuple[float, float],
    ) -> Floats:
        """Return the images of all beads as `BeadMotion.place` does.

        Args:
            indenter: Number of the indenter.
            elastic_n: Elastic force [N].
            shear: Shear displacement of the skin, right and down [mm].
            turn_rad: Turn of the skin from right to down [rad].
            place_mm: Place of the contact from the first one [mm].
        """
        column, row = (int(np.floor(each / GRID_MM)) for each in place_mm)
        right, below = place_mm[0] / GRID_MM - column, place_mm[1] / GRID_MM - row
        corners = [
            (self._motion(indenter, column + i, row + j), abs(1 - i - right) * abs(1 - j - below))
            for i in (0, 1)
            for j in (0, 1)
            if abs(1 - i - right) * abs(1 - j - below) > 0.0
        ]
        motion = corners[0][0]
        level = float(motion.row_of(0, np.array(elastic_n)))
        rows = motion.rows(level)
        if len(corners) > 1:
            rows = np.asarray(sum(weight * each.rows(level) for each, weight in corners))
        x, y = self._contact_mm
        centre = (x + place_mm[0], y + place_mm[1])
        part = level - min(int(level), ROWS - 2)
        return motion.place_turned(rows, part, shear, (turn_rad, centre))

    def _motion(self, indenter: int, column: int, row: int) -> BeadMotion:
        key = (indenter, column, row)
        if key not in self._found:
            x, y = self._contact_mm
            self._found[key] = self._at(indenter, (x + GRID_MM * column, y + GRID_MM * row))
        return self._found[key]


def _optics_row(lens: Lens, diameter_mm: float) -> Floats:
    """Return what the projection needs as one array; see ``_place``."""
    return np.array(
        [
            lens.image_distance_px,
            lens.k1,
            lens.k2,
            lens.centre_px[0],
            lens.centre_px[1],
            float(lens.distance_mm(0.0)),
            float(lens.distance_mm(1.0) - lens.distance_mm(0.0)),
            float(lens.distance_mm(lens.focus_depth_mm)),
            float(lens.focal_mm / lens.f_number * lens.magnification / PITCH_MM),
            lens.softness_px,
            np.cos(lens.roll_rad),
            np.sin(lens.roll_rad),
            0.5 * diameter_mm,
        ]
    )


@njit(cache=True, nogil=True, error_model='numpy')
def _place(
    table: Floats,
    row: float,
    shear_x: float,
    shear_y: float,
    follow: Floats,
    added: Floats,
    rest: Floats,
    optics: Floats,
    spots: Floats,
) -> None:
    """Displace and project all beads; the same optics as ``Lens``, with the values at hand."""
    gain, k1, k2, centre_x, centre_y, far, per_mm, focus, blur, soft, cos, sin, radius = optics
    low = min(int(row), table.shape[0] - 2)
    part = row - low
    moved = np.empty(8)
    for i in range(spots.shape[0]):
        for k in range(8):
            moved[k] = (1.0 - part) * table[low, i, k] + part * table[low + 1, i, k]
        size = follow[i] if follow.shape[0] else 1.0
        u, v = size * shear_x, size * shear_y
        x = rest[0, i] + moved[0] + moved[3] * u + moved[4] * v
        y = rest[1, i] + moved[1] + moved[4] * u + moved[5] * v
        z = rest[2, i] + moved[2] + moved[6] * u + moved[7] * v
        if added.shape[0]:
            x += shear_x * added[i]
            y += shear_y * added[i]
        distance = far + per_mm * z
        slope_x = (cos * x - sin * y) / distance
        slope_y = (sin * x + cos * y) / distance
        square = slope_x * slope_x + slope_y * slope_y
        bend = gain * (1.0 + square * (k1 + k2 * square))
        spots[i, 0] = centre_x + bend * slope_x
        spots[i, 1] = centre_y + bend * slope_y
        # Mean of the radial and the tangential scale: images stay round.
        stretch = gain * (1.0 + square * (2.0 * k1 + 3.0 * k2 * square))
        spots[i, 2] = radius * stretch / distance
        spots[i, 3] = np.sqrt(soft * soft + (blur * (distance - focus) / distance) ** 2)
