# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trials to train on and to judge by, simulated or recorded, as the same arrays."""
