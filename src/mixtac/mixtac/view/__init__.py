# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The live view in a browser: events, frame, force against reference, contact, state."""
