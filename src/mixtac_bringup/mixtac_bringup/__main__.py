# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`python -m mixtac_bringup`: the command line."""

import sys

from mixtac_bringup.cli import main

if __name__ == '__main__':
    sys.exit(main())
