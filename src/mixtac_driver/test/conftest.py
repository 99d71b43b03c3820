# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Makes the helpers beside the tests importable."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
# Recordings to play, and a camera that fails on request.
for folder in ('mixtac_core/test/recordings', 'mixtac_sim/test/usb'):
    sys.path.append(str(Path(__file__).parents[2] / folder))
