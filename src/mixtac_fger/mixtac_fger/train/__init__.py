# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training: one loop for all networks, with resume, early stop and data-parallel processes."""
