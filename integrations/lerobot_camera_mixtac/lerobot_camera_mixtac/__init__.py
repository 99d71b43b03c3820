# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The Mixtac tactile sensor as a camera of LeRobot, which finds this package by its name."""

from lerobot_camera_mixtac.camera import MixtacCamera, MixtacCameraConfig

__all__ = ['MixtacCamera', 'MixtacCameraConfig']
