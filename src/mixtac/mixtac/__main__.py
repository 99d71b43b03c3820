# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`python -m mixtac`: the command line."""

from __future__ import annotations

import sys

from mixtac.main import main

if __name__ == '__main__':
    sys.exit(main())
