# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trials to learn from and to judge by: simulated ones and bags, as the same arrays."""
