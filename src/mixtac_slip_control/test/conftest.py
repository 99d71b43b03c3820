# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The first call of a compiled function takes seconds: examples have no deadline."""

from hypothesis import settings

settings.register_profile('mixtac', deadline=None)
settings.load_profile('mixtac')
