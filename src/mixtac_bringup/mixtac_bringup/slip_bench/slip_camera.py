# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A camera that sends knocks, served in a process of its own; see `pattern_server`.

Its origin is told on the host's monotonic clock, which all processes of a machine share.
"""

from __future__ import annotations

import argparse
import json
import signal
import threading
import time

from mixtac_bringup.benchmark.pattern_server import wake_in_time
from mixtac_bringup.slip_bench.slip_pattern import make_slip_pattern
from mixtac_sim.usb.pattern_camera import PatternCamera
from mixtac_sim.usb.server import UsbServer

POLL_S = 0.02


def _say(**values: object) -> None:
    print(json.dumps(values), flush=True)


def main() -> None:
    """Serve until SIGTERM."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--socket', required=True)
    parser.add_argument('--seconds', type=float, default=12.0, help='length of a period')
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--slowest', type=float, default=30.0, help='mm/s')
    parser.add_argument('--fastest', type=float, default=100.0, help='mm/s')
    options = parser.parse_args()
    wake_in_time()
    stopping = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stopping.set())
    signal.signal(signal.SIGINT, lambda *_: stopping.set())
    slips = make_slip_pattern(options.seconds, options.seed, (options.slowest, options.fastest))
    camera = PatternCamera('SLIP0001', slips.pattern)
    # The camera counts true time from its construction on the host's monotonic clock, without skew.
    zero_ns = time.monotonic_ns() - camera.true_time_us() * 1000
    server = UsbServer(camera, options.socket)
    _say(
        ready=True,
        period_us=slips.pattern.period_us,
        onsets_us=slips.onsets_us,
        speeds_mm_s=slips.speeds_mm_s,
    )
    origin_us = camera.clock_origin_us
    while not stopping.wait(POLL_S):
        if camera.clock_origin_us != origin_us:
            origin_us = camera.clock_origin_us
            _say(origin_ns=zero_ns + origin_us * 1000)
    server.close()
    _say(periods_lost=camera.player.periods_lost)


if __name__ == '__main__':
    main()
