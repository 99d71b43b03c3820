# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Further experiments: model tables, adaptation, simulator difficulty, clock errors, tones."""
