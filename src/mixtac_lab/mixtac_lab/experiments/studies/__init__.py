# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Further experiments: model tables, adaptation, difficulty of the simulator, clock errors, tones."""
