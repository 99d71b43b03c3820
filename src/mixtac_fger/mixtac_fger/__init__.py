# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Normal force from frames and events: networks, streaming inference, training, the node."""
