# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Event arrays, camera readings, packet encodings, time windows: NumPy and numba, no ROS."""
