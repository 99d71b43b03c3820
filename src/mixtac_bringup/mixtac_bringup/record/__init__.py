# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Recording the sensor's topics: checks before, figures while, and what was lost after."""
