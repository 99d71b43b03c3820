# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""USB transport: devices, register requests, and synchronous and asynchronous reads."""
