# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""An indenter that is moved sideways, turned about the normal and rolled while it presses.

The skin under it is a spring along each axis: the block in shear of `Shear`, and for a turn the
disc on a half-space, 16 / 3 G a^3 (Reissner and Sagoci 1944; the bonded layer adds less than 7 %
up to a contact as wide as the layer is thick). Each spring relaxes as the layer does under the
normal force, so that a skin that is let go creeps back. With partial slip the pull over the
indenter's way x against the skin, in units of stiffness and largest pull, is

    1 - (1 - x / 1.5)^1.5                         (Cattaneo 1938, Mindlin 1949)
    2 / 3 [1 - (2 - sqrt(1 + 8 x'))^2] / (3 pi / 16),  x' = 9 pi / 256 x   (turn; Deresiewicz 1954)

and beyond its end the whole contact slides; without partial slip it sticks up to there. Under a
round body friction bears a torque of 3 pi / 16 mu F a. Partial slip has no memory (a reversal
causes no hysteresis loop), and a slide and a turn do not share the friction. Rolling moves the
contact without a sideways force: free rolling without creep, and without the loss in the skin. If a
force pulls at the indenter, its displacement follows from these laws; beyond the friction limit it
slides.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from mixtac_core.events.arrays import Floats
from mixtac_sim.grids import STEP_US
from mixtac_sim.mechanics.contact import ContactPath, PronySeries, force_terms, relax
from mixtac_sim.mechanics.elastomer import Shear

WHOLE_SLIP = 1.5
"""Way over largest pull and stiffness at which the whole contact slides."""
WHOLE_TURN = 1.9823764
"""The same of a turn: where Deresiewicz's torque is 3 pi / 16."""
TORQUE_SHARE = 3.0 * np.pi / 16.0
"""Largest torque over friction, force and radius."""
SLIDING_MM_S = 10.0
"""Speed at which a force beyond friction moves the indenter [mm/s] (estimate)."""
SMALLEST_MM = 0.05
"""A contact counts as this wide at least [mm]."""


class Across(NamedTuple):
    """What happens across the normal, on the command grid; entry k is the end of step k.

    Attributes:
        shear_mm: Displacement of the skin, right and down [n, 2] [mm].
        pull_n: Force on the skin [n, 2] [N].
        turn_rad: Turn of the skin from right to down [n] [rad].
        torque_nm: Torque on the skin about the normal [n] [Nm].
        place_mm: Where on the skin the contact is, from where the first one was [n, 2] [mm].
    """

    shear_mm: Floats
    pull_n: Floats
    turn_rad: Floats
    torque_nm: Floats
    place_mm: Floats


class Sliding:
    """State of skin and indenter across the normal, advanced along the motion of the indenter.

    Args:
        shear: Stiffness and friction of the skin, and the lean of the indenter.
        prony: Relaxation of the layer.
    """

    def __init__(self, shear: Shear, prony: PronySeries) -> None:
        self._shear = shear
        self._update = prony.update(1e-6 * STEP_US)
        # Way against the skin, displacement of the skin, place of the contact and of the indenter,
        # along right, down, turn.
        self._state = np.zeros((4, 3))
        self._branches = np.zeros((3, len(prony.weights)))
        self._depth_mm = 0.0

    def advance(self, moves: Floats, path: ContactPath, radius_mm: Floats) -> Across:
        """Move the indenter.

        Args:
            moves: Motion over each step and pull, as of `Profile.motion` [n, 7].
            path: The contact along the normal [n].
            radius_mm: Contact radius [n] [mm].
        """
        shear, radius = self._shear, np.maximum(radius_mm, SMALLEST_MM)
        deeper = np.diff(path.depth_mm, prepend=self._depth_mm)
        self._depth_mm = float(path.depth_mm[-1])
        way, rolled, pulled = moves[:, :3].copy(), moves[:, 3:5], moves[:, 5:]
        way[:, :2] += deeper[:, None] * shear.lean
        stiffness = np.stack([shear.stiffness(radius), shear.turn_stiffness(radius)], axis=1)
        friction = shear.limit(path.force_n)
        limit = np.stack([friction, TORQUE_SHARE * friction * radius], axis=1)
        steps = np.empty((len(moves), 3, 3))
        state, branches = self._state, self._branches
        given = (way, rolled, pulled, stiffness, limit)
        _advance(state, branches, self._update, *given, shear.partial_slip, steps)
        return Across(
            steps[:, 0, :2],
            steps[:, 1, :2],
            steps[:, 0, 2],
            1e-3 * steps[:, 1, 2],
            steps[:, 2, :2],
        )


@njit(cache=True, nogil=True)
def borne(held: float, limit: float, turn: bool, partial_slip: bool) -> float:
    """Return the pull of a contact that sticks, slips at its rim, or slides.

    Args:
        held: Pull if all of it stuck, not negative.
        limit: Largest pull, not negative.
        turn: A torque and not a force.
        partial_slip: Whether the rim slips first.
    """
    if limit <= 0.0:
        return 0.0
    way = held / limit
    if not partial_slip:
        return min(way, 1.0) * limit
    if turn:
        if way >= WHOLE_TURN:
            return limit
        stuck = 2.0 - np.sqrt(1.0 + 8.0 * way * TORQUE_SHARE * 3.0 / 16.0)
        return float(limit * (1.0 - stuck * stuck) / (1.5 * TORQUE_SHARE))
    return float(limit * (1.0 - max(1.0 - way / WHOLE_SLIP, 0.0) ** 1.5))


@njit(cache=True, nogil=True)
def held_by(pull: float, limit: float, partial_slip: bool) -> float:
    """Return the pull if all of it stuck of a contact that bears `pull` [N], up to `limit`."""
    if not partial_slip or pull >= limit:
        return pull
    return float(WHOLE_SLIP * limit * (1.0 - (1.0 - pull / limit) ** (2.0 / 3.0)))


@njit(cache=True, nogil=True)
def _follow(
    pulled: Floats,
    limit: float,
    stiffness: float,
    partial_slip: bool,
    carried: Floats,
    gain: float,
    held: Floats,
    way: Floats,
) -> None:
    """Write the way on which an indenter follows a force, if one pulls; see ``_advance``."""
    wanted = np.hypot(pulled[0], pulled[1])
    if not wanted >= 0.0:
        return
    part = held_by(wanted, limit, partial_slip) / stiffness
    for axis in range(2):
        along = pulled[axis] / max(wanted, 1e-12)
        way[axis] = (part * along - carried[axis]) / gain - held[axis]
        if wanted >= limit:
            way[axis] = along * SLIDING_MM_S * 1e-6 * STEP_US * (limit > 0.0)


@njit(cache=True, nogil=True)
def _advance(
    state: Floats,
    branches: Floats,
    update: Floats,
    way: Floats,
    rolled: Floats,
    pulled: Floats,
    stiffness: Floats,
    limit: Floats,
    partial_slip: bool,
    steps: Floats,
) -> None:
    """Carry out the motion; see ``Sliding.advance``.

    Args:
        state: Way against the skin, displacement of the skin, place of the contact and of the
            indenter [4, axis]; changes.
        branches: Branches of the displacement [axis, branch]; change.
        update: Coefficients of a step, of ``PronySeries.update``.
        way: Motion of the indenter against the skin [n, axis]; nan where it goes back to where the
            first contact was, and changes.
        rolled: How far the contact rolls [n, 2].
        pulled: Force that pulls at the indenter [n, 2] [N], nan where none does.
        stiffness: Of shear [N/mm] and of the turn [N mm/rad] [n, 2].
        limit: Largest pull [N] and torque [N mm] [n, 2].
        partial_slip: Whether the rim slips first.
        steps: Displacement of the skin, pull, place after each step [n, 3, axis].
    """
    held, carried, gain = np.zeros(3), np.zeros(3), 1.0
    for k in range(way.shape[0]):
        if np.isnan(way[k, 2]):
            state[3] = way[k] = 0.0
        for axis in range(3):
            spring = stiffness[k, axis // 2]
            carried[axis], gain = force_terms(branches[axis], update, state[1, axis])
        _follow(
            pulled[k], limit[k, 0], stiffness[k, 0], partial_slip, carried, gain, state[0], way[k]
        )
        for axis in range(3):
            spring = stiffness[k, axis // 2]
            state[0, axis] += way[k, axis]
            state[3, axis] += way[k, axis]
            if axis < 2:
                state[3, axis] += rolled[k, axis]
            held[axis] = spring * (carried[axis] + gain * state[0, axis])
        for turn in range(2):
            first, last = (2, 3) if turn else (0, 2)
            size = abs(held[2]) if turn else np.hypot(held[0], held[1])
            most, spring = limit[k, turn], stiffness[k, turn]
            whole = (WHOLE_TURN if turn else WHOLE_SLIP) if partial_slip else 1.0
            pull = borne(size, most, turn == 1, partial_slip)
            kept = min(1.0, whole * most / size) if size > 0.0 else 1.0
            for axis in range(first, last):
                force = held[axis] * pull / size if size > 0.0 else 0.0
                stuck = (kept * held[axis] / spring - carried[axis]) / gain
                state[0, axis] = stuck
                # The dent of a contact that has ended stays where it is until the next one.
                if most > 0.0:
                    state[2, axis] = state[3, axis] - stuck
                skin = (force / spring - carried[axis]) / gain
                relax(branches[axis], update, skin - state[1, axis])
                state[1, axis] = skin
                steps[k, 0, axis], steps[k, 1, axis] = skin, force
                steps[k, 2, axis] = state[2, axis]
