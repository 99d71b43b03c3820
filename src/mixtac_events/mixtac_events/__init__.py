# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The shared vocabulary of Mixtac: event arrays, packet encodings, time windows."""
