# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Benchmarks that need more than one package; `mixtac bench` runs them."""
