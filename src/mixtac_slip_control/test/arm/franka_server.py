# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Serves a simulated FR3 over the Franka control interface on 127.0.0.1 until it is ended.

Runs in an environment of its own (requirements/franka.txt). Every limit that the robot would
enforce is enforced.
"""

import logging
import sys

from franka_sim.franka_sim_server import FrankaSimServer
from franka_sim.mujoco_franka_sim import MujocoFrankaSim

if __name__ == '__main__':
    logging.basicConfig(level=logging.WARNING, stream=sys.stderr)
    server = FrankaSimServer(
        host='127.0.0.1',
        physics_sim=MujocoFrankaSim(model_path=sys.argv[1]),
        enable_gripper=False,
        enforce_comm_constraints=True,
        enforce_motion_limits=True,
    )
    server.start()
