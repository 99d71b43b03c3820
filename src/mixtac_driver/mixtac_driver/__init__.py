# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The DAVIS346 event camera: USB transport, stream decoder, camera object, driver node."""
