# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Train the small network on a folder of bags: python train_on_own_bags.py [FOLDER].

Each bag begins untouched, holds a reference force, and is aligned (`mixtac align FOLDER`). Without
a folder, a few trials are simulated. The settings here show the way; for good weights raise the
epochs, and record some dozens of trials.
"""

import subprocess
import sys
from pathlib import Path

settings = """
model: ours
out: mine.safetensors
training: {recurrent_epochs: 2}
data: {bags: [FOLDER], checked: 0.25}
judged: 0
"""
mixtac = [sys.executable, '-m', 'mixtac']
folder = Path(sys.argv[1] if len(sys.argv) > 1 else 'trials')
if not folder.exists():
    trials = ('--profile', 'dynamic', '--trials', '5', '--seconds', '5', '--out', folder)
    subprocess.run([*mixtac, 'simulate', *trials], check=True)
file = Path('mine.yaml')
file.write_text(settings.replace('FOLDER', str(folder.resolve())))
subprocess.run([*mixtac, 'train', file, '--folder', 'run'], check=True)
