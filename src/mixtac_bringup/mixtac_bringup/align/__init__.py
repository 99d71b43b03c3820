# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Alignment of recorded and live forces: the bag tool, its figure, and the error monitor."""
