# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The estimator runs without the packages of training."""

from __future__ import annotations

import subprocess
import sys

CODE = """
import sys
sys.modules.update(dict.fromkeys(['torch', 'matplotlib', 'mixtac_learning', 'mixtac_sim']))
from mixtac_fger.estimator import open_estimator
from mixtac_fger.weights import find_model, read_model
import mixtac_fger.live_feed
print(open_estimator(read_model(find_model('fger_small'))).window_us)
"""


def test_the_shipped_model_opens_where_torch_cannot_be_imported():
    done = subprocess.run([sys.executable, '-c', CODE], check=True, capture_output=True, text=True)
    assert done.stdout.split() == ['2000']
