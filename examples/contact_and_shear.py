# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Print where a recording is touched and the shear force: python contact_and_shear.py BAG."""

import subprocess
import sys
from pathlib import Path

from mixtac_core.recordings.camera_stream import open_recording
from mixtac_core.recordings.messages import left_aligned
from mixtac_fger.contact_tracking import ContactSettings
from mixtac_fger.estimator import open_estimator
from mixtac_fger.streaming import ForceEstimator
from mixtac_fger.weights import find_model, read_model

if len(sys.argv) > 1:
    bag = Path(sys.argv[1])
else:
    trial = ('--profile', 'shear', '--trials', '1', '--seconds', '8', '--out', 'shear')
    subprocess.run([sys.executable, '-m', 'mixtac', 'simulate', *trial], check=True)
    bag = Path('shear/trial_000')
model = read_model(find_model('fger_small'))
estimator = ForceEstimator(open_estimator(model), assume_free=True, contact=ContactSettings())
recording = open_recording(bag)
for piece in recording.pieces():
    for frame in piece.frames:
        estimator.push_frame(left_aligned(frame.image), frame.middle_us)
    for each in estimator.push_events(piece.events, piece.until_us) if piece.advances else ():
        if each.contact and (place := each.contact.shape) and each.end_us % 100_000 == 0:
            shear = each.shear
            across = f'{shear.x:.3f} {shear.y:.3f} N' if shear else 'unknown'
            print(f'normal {each.force:.3f} N, shear {across}', end='')
            print(f', at {place.x_mm:.1f} {place.y_mm:.1f} mm')
