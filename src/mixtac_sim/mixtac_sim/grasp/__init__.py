# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""An object between fingertip and wall: friction, slip, and their effect on the sensor."""
