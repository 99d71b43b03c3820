# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Simulated trials as rosbag2 bags: the topics of the live graph, and the truth."""
