# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Brings the Mixtac graph up, with or without `ros2 launch`; the command line."""
