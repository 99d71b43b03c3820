# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The virtual DAVIS346: a USB device in software that speaks the camera's real protocol."""
