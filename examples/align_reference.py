# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bring a reference force to the camera clock: python align_reference.py BAG.

The bag begins and ends with a tap on the sensor. Without one, a trial is simulated.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np

from mixtac_fger.alignment.align import align
from mixtac_fger.alignment.bags import read_recording

if len(sys.argv) > 1:
    bag = Path(sys.argv[1])
else:
    trial = ('--profile', 'dynamic', '--trials', '1', '--seconds', '8', '--out', 'taps')
    subprocess.run([sys.executable, '-m', 'mixtac', 'simulate', *trial], check=True)
    bag = Path('taps/trial_000')
recording = read_recording(bag)
fit = align(recording)
print(fit.summary())
camera_us = fit.to_camera(recording.force_t_s)
peak = int(np.argmax(np.abs(recording.force)))
print(f'largest force {recording.force[peak]:.3f} N at {camera_us[peak]} us of the camera clock')
