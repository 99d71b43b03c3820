# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Makes helpers of the tests of other packages importable."""

from __future__ import annotations

import sys
from pathlib import Path

SOURCE = Path(__file__).parents[2]
for helper in ('usb_oracle', 'davis_oracle', 'decoder_cases', 'lossy_link'):
    folders = {str(path.parent) for path in SOURCE.glob(f'*/test/**/{helper}.py')}
    sys.path[:0] = sorted(folders - set(sys.path))
