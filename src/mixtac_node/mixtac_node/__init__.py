# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What every Mixtac node shares: parameter schema, QoS, diagnostics, the run loop."""
