# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The arm: kinematics, limits, jerk-limited advances along the contact normal, backends."""
