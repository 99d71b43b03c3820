# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What every Mixtac node shares: parameters, run loop, topics, diagnostics, images, processes."""
