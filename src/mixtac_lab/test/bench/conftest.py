# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Makes the test decoders importable: `usb_oracle` of the virtual camera, `davis_oracle`."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[3] / 'mixtac_sim' / 'test' / 'usb'))
sys.path.append(str(Path(__file__).parents[3] / 'mixtac_driver' / 'test'))
