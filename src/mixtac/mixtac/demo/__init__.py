# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac demo`: a scripted run on the virtual sensor, measured and drawn."""
