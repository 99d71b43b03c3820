# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Recordings in place of a camera: rosbag2 bags and AEDAT4 files, played on a clock."""
