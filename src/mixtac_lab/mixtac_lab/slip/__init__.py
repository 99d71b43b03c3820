# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Slip trials in closed loop, shared by the slip experiment and the slip benchmark."""
