# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Normal force from frames and events at run time: FGER-Net, its features and its node."""
