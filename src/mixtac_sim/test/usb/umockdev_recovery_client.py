# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Keeps a camera streaming through libusb and says how that goes.

Run as ``python umockdev_recovery_client.py REPORT DONE``: it writes its figures to REPORT again and
again until DONE exists.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import psutil

from mixtac_driver.camera import Davis346
from mixtac_driver.parameters import DriverParameters
from mixtac_driver.supervisor import Supervisor


def main():
    report, done = map(Path, sys.argv[1:])
    camera = Davis346(DriverParameters(stream_timeout=3.0))
    batches, went_back = [0], [0]

    def on_batch(batch):
        went_back.append(max(batch.time_us, went_back[-1]))
        batches.append(batches[-1] + 1)
        assert went_back[-1] == batch.time_us, 'time went back'

    supervisor = Supervisor(camera, on_start=lambda: None, on_batch=on_batch, on_error=print)
    supervisor.start()
    process = psutil.Process()
    while not done.exists():
        figures = {
            'state': supervisor.state.value,
            'failures': supervisor.failures_by_kind,
            'reconnects': supervisor.reconnects,
            'stalls': camera.transport_counters.stalls,
            'batches': batches[-1],
            'held': (process.num_threads(), process.num_fds()),
        }
        fresh = report.with_suffix('.new')
        fresh.write_text(json.dumps(figures))
        fresh.replace(report)
        time.sleep(0.02)
    sys.exit(0 if supervisor.stop() else 'the driver did not stop')


if __name__ == '__main__':
    main()
