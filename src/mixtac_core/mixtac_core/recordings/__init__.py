# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Recordings: rosbag2 bags and AEDAT4 files read, written, exported, summarised."""
