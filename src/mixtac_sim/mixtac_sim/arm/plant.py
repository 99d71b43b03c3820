# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Models of the arm behind its controller: a lag of each joint, or MuJoCo.

`LaggingArm` is a first-order lag of each joint. `MujocoArm` is an independent model: the lag of its
servos is a setting, too, while inertia, coupling of the joints, saturation of the torques and the
reaction of the gel are computed by MuJoCo. The servos of the real control unit are not public.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixtac_sim import SimulationError
from mixtac_sim.arm.fr3 import TORQUE_MAX_NM, GelContact, flange_place, fr3_mjcf

Floats = NDArray[np.float64]


TRACKING_LAG_S = 3.5e-3
"""Time constant of the arm's own position control [s]: 3 to 4 ms were seen on libfranka's wire
protocol in simulation, 40 ms with the effort controller that franka_ros2 ships."""


class LaggingArm:
    """Joints that follow their commands with a first-order lag.

    Args:
        q: Joint positions at the start [7] [rad].
        normal: Direction of the fingertip's advance in the base frame [3], of length 1.
        lag_s: Time constant of the lag [s].
        period_s: Period of the commands [s].

    Raises:
        SimulationError: The lag is negative.
    """

    def __init__(
        self, q: Floats, normal: Floats, lag_s: float = TRACKING_LAG_S, period_s: float = 1e-3
    ) -> None:
        if lag_s < 0.0:
            raise SimulationError(f'tracking lag of {lag_s} s; give 0 or more')
        self._q = np.array(q, np.float64)
        self._keep = float(np.exp(-period_s / lag_s)) if lag_s > 0.0 else 0.0
        self._normal = normal
        self._start = flange_place(self._q)
        self._last_mm = 0.0

    @property
    def q(self) -> Floats:
        """Return the joint positions [7] [rad]."""
        return self._q.copy()

    def track(self, command: Floats) -> None:
        """Advance one period towards commanded joint positions [7] [rad]."""
        self._q = command + self._keep * (self._q - command)

    def follow(self, command: Floats, points: int) -> Floats:
        """Advance one period of the commands.

        Args:
            command: Commanded joint positions [7] [rad].
            points: Number of places to return.

        Returns:
            Places of the fingertip along the normal, at the ends of as many equal parts of the
            period [mm] from the start.
        """
        self.track(command)
        place_mm = 1e3 * float((flange_place(self._q) - self._start) @ self._normal)
        way = np.linspace(self._last_mm, place_mm, points + 1)[1:]
        self._last_mm = place_mm
        return way


JOINTS = 7
STEP_S = 0.25e-3
"""Step of the model, in ``fr3.xml`` [s]."""
SETTLE_S = 0.2
"""Time in which servos and gel come to rest under the preload [s]."""
REMEDY = 'python3 tools/setup.py --with mujoco, or pip install -r requirements/mujoco.txt'


class MujocoArm:
    """An FR3 that follows joint commands and presses a gel against a wall.

    Args:
        q: Joint positions at the start [7] [rad].
        normal: Direction of the advance in the base frame [3], of length 1.
        lag_s: With which a joint follows a ramp [s], positive; the servos are critically damped.
        period_s: Period of the commands [s], a multiple of 0.25 ms.
        n_per_mm: Stiffness of the gel [N/mm]; 0: nothing is touched.
        preload_n: Force at the start [N].

    Attributes:
        saturated: Steps in which a servo reached its largest torque.

    Raises:
        SimulationError: MuJoCo is not installed, or a value is out of range.
    """

    def __init__(
        self,
        q: Floats,
        normal: Floats,
        lag_s: float = TRACKING_LAG_S,
        period_s: float = 1e-3,
        *,
        n_per_mm: float = 0.0,
        preload_n: float = 0.0,
    ) -> None:
        if not lag_s > 0.0 or n_per_mm < 0.0:
            msg = f'lag {lag_s} s, stiffness {n_per_mm} N/mm: give a lag > 0 and no negative one'
            raise SimulationError(msg)
        if abs(period_s - STEP_S * max(round(period_s / STEP_S), 1)) > 1e-9:
            raise SimulationError(
                f'MuJoCo cannot compute a period of {1e3 * period_s:g} ms in steps of 0.25 ms',
                remedy='give an update rate of 4000 Hz over a whole number, such as 1000 Hz',
            )
        try:
            # No types without the package.
            self._mujoco: Any = importlib.import_module('mujoco')
        except ImportError as error:
            msg = f'the arm in MuJoCo needs the package mujoco ({error}): {REMEDY}'
            raise SimulationError(msg) from error
        self._start_q = np.array(q, np.float64)
        self._normal = np.asarray(normal, np.float64)
        contact = self._contact(n_per_mm, preload_n) if n_per_mm > 0.0 else None
        self._model, self._data = self._posed(fr3_mjcf(contact, self._stiffness(lag_s), lag_s))
        self._steps = round(period_s / STEP_S)
        self._touches = contact is not None
        self.saturated = 0
        self._data.ctrl[:] = self._start_q
        for _ in range(round(SETTLE_S / STEP_S)):
            self._step()
        self.saturated = 0
        self._origin = self.flange
        self._last_mm = 0.0

    @property
    def q(self) -> Floats:
        """Return the joint positions [7] [rad]."""
        return np.array(self._data.qpos[:JOINTS])

    @property
    def torque(self) -> Floats:
        """Return the torques of the servos [7] [N m]."""
        return np.array(self._data.actuator_force)

    @property
    def flange(self) -> Floats:
        """Return the place of the flange [3] [m] in the base frame."""
        return np.array(self._data.site('flange').xpos)

    @property
    def contact_n(self) -> float:
        """Return the normal force between gel and wall [N], at rest that of the spring.

        In motion the mass that MuJoCo needs at the surface of the gel adds shocks.
        """
        force = np.zeros(6)
        total = 0.0
        for k in range(self._data.ncon if self._touches else 0):
            self._mujoco.mj_contactForce(self._model, self._data, k, force)
            total += float(force[0])
        return total

    @property
    def gel_n(self) -> float:
        """Return the force of the gel's spring on the arm [N]."""
        if not self._touches:
            return 0.0
        joint = self._model.joint('gel')
        compression = float(
            self._model.qpos_spring[joint.qposadr[0]] - self._data.joint('gel').qpos[0]
        )
        return float(self._model.jnt_stiffness[joint.id]) * compression

    def track(self, command: Floats) -> None:
        """Advance one period towards commanded joint positions [7] [rad]."""
        self._data.ctrl[:] = command
        for _ in range(self._steps):
            self._step()

    def follow(self, command: Floats, points: int) -> Floats:
        """Advance one period of the commands.

        Args:
            command: Commanded joint positions [7] [rad].
            points: Number of places to return.

        Returns:
            Places of the fingertip at the ends of as many equal parts of the period [mm].
        """
        self._data.ctrl[:] = command
        places = np.empty(self._steps + 1)
        places[0] = self._last_mm
        for k in range(self._steps):
            self._step()
            places[k + 1] = 1e3 * float((self.flange - self._origin) @ self._normal)
        self._last_mm = float(places[-1])
        wanted = np.linspace(0.0, self._steps, points + 1)[1:]
        return np.interp(wanted, np.arange(self._steps + 1), places)

    def _step(self) -> None:
        self._mujoco.mj_step(self._model, self._data)
        self.saturated += bool(np.any(np.abs(self._data.actuator_force) >= TORQUE_MAX_NM))

    def _posed(self, mjcf: str) -> tuple[Any, Any]:
        """Return a model and its data at the joint positions of the start."""
        model = self._mujoco.MjModel.from_xml_string(mjcf)
        data = self._mujoco.MjData(model)
        data.qpos[:JOINTS] = self._start_q
        self._mujoco.mj_forward(model, data)
        return model, data

    def _stiffness(self, lag_s: float) -> list[float]:
        """Return the stiffness of critically damped servos for the inertia at the start."""
        model, data = self._posed(fr3_mjcf())
        inertia = np.zeros((JOINTS, JOINTS))
        self._mujoco.mj_fullM(model, inertia, data.qM)
        # Damping over stiffness is the lag, and at critical damping twice the time constant.
        return list((np.diag(inertia) * (2.0 / lag_s) ** 2).tolist())

    def _contact(self, n_per_mm: float, preload_n: float) -> GelContact:
        _, data = self._posed(fr3_mjcf())
        turn = np.array(data.site('flange').xmat).reshape(3, 3)
        place = flange_place(self._start_q)
        in_flange = (turn.T @ self._normal).tolist()
        return GelContact(
            place.tolist(), self._normal.tolist(), in_flange, 1e3 * n_per_mm, preload_n
        )
