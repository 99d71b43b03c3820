# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A camera that sends a pattern, served in a process of its own.

Prints one JSON object per line: `ready` once a host may open it, `origin_ns` whenever its clock was
reset (host time [ns since the Unix epoch] at which it read zero), and at the end what was lost.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import signal
import sys
import threading
import time

from mixtac_lab.bench.pattern import PatternCamera, make_pattern
from mixtac_sim.usb.server import UsbServer

POLL_S = 0.02
PR_SET_TIMERSLACK = 29
TIMER_SLACK_NS = 1000


def _say(**values: object) -> None:
    print(json.dumps(values), flush=True)


def wake_in_time() -> None:
    """Let sleeping threads wake when they asked to: by default Linux adds 50 us, a camera none."""
    if sys.platform == 'linux':
        ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, TIMER_SLACK_NS, 0, 0, 0)


def main() -> None:
    """Serve until SIGTERM."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--socket', required=True)
    parser.add_argument('--rate', type=float, required=True, help='events per second')
    parser.add_argument('--per-row', type=float, default=1.0, help='events per row')
    parser.add_argument('--frame-interval', type=int, default=0, help='us, 0 for none')
    parser.add_argument('--reading-interval', type=int, default=0, help='us, 0 for none')
    options = parser.parse_args()
    wake_in_time()
    stopping = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stopping.set())
    signal.signal(signal.SIGINT, lambda *_: stopping.set())
    pattern = make_pattern(
        options.rate,
        events_per_row=options.per_row,
        frame_interval_us=options.frame_interval,
        reading_interval_us=options.reading_interval,
        wraps=8,
    )
    camera = PatternCamera('PATTERN1', pattern)
    # The camera counts true time from its construction on the monotonic clock.
    zero_ns = time.time_ns() - camera.true_time_us() * 1000
    server = UsbServer(camera, options.socket)
    _say(ready=True, events=len(pattern.events), period_us=pattern.period_us)
    origin_us = camera.clock_origin_us
    while not stopping.wait(POLL_S):
        if camera.clock_origin_us != origin_us:
            origin_us = camera.clock_origin_us
            _say(origin_ns=zero_ns + origin_us * 1000)
    server.close()
    _say(periods_lost=camera.player.periods_lost)


if __name__ == '__main__':
    main()
