# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac calibrate-force`: the gain of a sensor by weights or a kitchen scale."""
