# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Record five seconds and read them with numpy: python record_and_read.py [BAG]."""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

bag = Path(sys.argv[1] if len(sys.argv) > 1 else 'my_bag')
mixtac = [sys.executable, '-m', 'mixtac']
if not bag.exists():  # recording needs the ROS nodes; reading does not
    record = ['up', '--device', 'virtual', '--seconds', '5', '--record', str(bag)]
    subprocess.run([*mixtac, *record], check=True)
with tempfile.TemporaryDirectory() as folder:
    tables = Path(folder) / 'tables'
    subprocess.run([*mixtac, 'export', str(bag), '--to', 'npz', '--out', tables], check=True)
    events = np.load(tables / 'events.npz')
    frames = np.load(tables / 'frames.npz')
    seconds = (events['t'] - events['t'][0]) / 1e6
    print(f'{len(seconds)} events in {seconds[-1]:.2f} s, {events["polarity"].mean():.0%} ON')
    print(f'{len(frames["image"])} frames of {frames["image"].shape[1:]} pixels')
    for path in sorted(tables.glob('*wrench.npz')):
        force = np.load(path)['force'][:, 2]
        print(f'{path.stem}: {len(force)} samples, at most {force.max():.3f} N')
# With pandas: export --to csv, then pandas.read_csv(tables / 'events.csv').
