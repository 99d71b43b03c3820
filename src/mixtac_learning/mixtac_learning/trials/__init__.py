# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trials for training and evaluation, simulated or recorded, as the same arrays."""
