# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The simulated world: devices, days, profiles, instruments, trials, data sets."""
