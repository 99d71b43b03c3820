# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Data sets of simulated trials: which trials, how they are split, how they are described."""
