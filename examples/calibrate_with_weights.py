# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Calibrate with 20, 50 and 100 g: python calibrate_with_weights.py [BAG | davis346 | virtual].

A bag shows the weights put on the middle of the gel and taken off again, one after the other.
Without one, such a trial is simulated. With a camera the command asks for each weight.
"""

import subprocess
import sys
from pathlib import Path

source = sys.argv[1] if len(sys.argv) > 1 else ''
mixtac = [sys.executable, '-m', 'mixtac']
if not source:
    trial = ('--profile', 'weights', '--trials', '1', '--seconds', '17', '--out', 'weights')
    subprocess.run([*mixtac, 'simulate', *trial], check=True)
    source = 'weights/trial_000'
where = ('--bag', source) if Path(source).exists() else ('--device', source)
weights = Path('my_sensor.safetensors')
weights.unlink(missing_ok=True)
loads = ('--loads', '20,50,100', '--gel', 'soft_1', '--out', weights)
subprocess.run([*mixtac, 'calibrate-force', *where, *loads], check=True)
print(f"calibrated: Sensor('usb', model='{weights}')")
