# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A virtual camera that sends a pattern or knocks, served in a process of its own.

It prints one JSON object per line: `ready` as soon as a host may open it, `origin_ns` (host time
[ns since the Unix epoch] at which its clock was zero) and `monotonic_ns` (the same on the monotonic
clock) whenever its clock is reset, and `periods_lost` at the end.

The stream of knocks is one scene per knock, one after the other, simulated and encoded once. Before
each knock the object is held as at the start, because skin that a slip has sheared hardly moves in
the next one. No event and no frame belongs to two scenes.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from typing import Any

import numpy as np

from mixtac_events.arrays import Events
from mixtac_lab.bench.harness import send, stop_event
from mixtac_lab.bench.pattern import (
    WRAP_US,
    Pattern,
    PatternCamera,
    encode_pattern,
    make_pattern,
)
from mixtac_node.process import exact_sleeps, freeze_loaded
from mixtac_sim.grasp.slip_scene import SlipScene, knock_profile
from mixtac_sim.grids import STEP_US
from mixtac_sim.usb.server import UsbServer
from mixtac_sim.world.effects import preset

PERIOD_S = 12.0
SPEEDS_MM_S = (30.0, 100.0)
"""Range of the speeds of the object after a knock."""
QUIET_S = 2.0
"""Rest at the beginning of each period, for the background to be learned [s]."""
SPACING_S = 1.3
"""Length of the scene of one knock [s]: slip control is enabled again between knocks."""
BEFORE_S = 0.3
"""Rest before a knock in its scene [s], in which frames of the scene arrive."""
SPREAD_S = 0.25
"""Largest random delay of a knock [s], so that knocks are on no grid."""
SLIP_S = 0.01
"""Duration of the slip after a knock [s]."""
FRAME_TIMES = ('frame_start_us', 'exposure_start_us', 'exposure_end_us', 'frame_end_us')


def make_slip_pattern(
    seconds: float = PERIOD_S,
    seed: int = 0,
    preset_name: str = 'paper_like',
    quiet_s: float = QUIET_S,
) -> tuple[Pattern, dict[str, list[Any]]]:
    """Simulate knocks on one sensor and encode what its camera sends.

    Args:
        seconds: Length of a period, rounded to time wraps of the camera [s].
        seed: Seed of the sensor, the day, the times and the speeds.
        preset_name: Difficulty preset of the sensor.
        quiet_s: Rest at the beginning [s].

    Returns:
        Stream of the camera; `onsets_us`, the onset of each knock from the start of a period [us],
        and `speeds_mm_s`.
    """
    wraps = max(round(1e6 * seconds / WRAP_US), 1)
    period_us = wraps * WRAP_US
    rng = np.random.default_rng([seed, 11])
    count = max(round((1e-6 * period_us - quiet_s) / SPACING_S), 1)
    starts = [0, *(_on_grid(quiet_s + SPACING_S * k) for k in range(1, count)), period_us]
    events, frames, onsets, speeds = [], [], [], []
    for k in range(count):
        rest_s = (quiet_s if k == 0 else 0.0) + BEFORE_S
        onset = _on_grid(rest_s + rng.uniform(0.0, SPREAD_S))
        speed = float(rng.uniform(*SPEEDS_MM_S))
        length_us = starts[k + 1] - starts[k]
        profile = knock_profile(speed, 1e-6 * onset, SLIP_S, 1e-6 * length_us)
        # The events and the whole frames of one knock, from the start of its scene.
        for block in SlipScene(seed, seed, preset(preset_name)).play(profile):
            events.append(block.events.between(0, length_us).shifted(starts[k]))
            for frame in block.frames:
                if frame.frame_end_us < length_us:
                    times = {name: getattr(frame, name) + starts[k] for name in FRAME_TIMES}
                    frames.append(replace(frame, **times))
        onsets.append(starts[k] + onset)
        speeds.append(speed)
    pattern = encode_pattern(Events.concatenate(events), frames, [], period_us)
    return pattern, {'onsets_us': onsets, 'speeds_mm_s': speeds}


def _on_grid(time_s: float) -> int:
    """Return the nearest step of the simulation [us]."""
    return int(STEP_US * round(1e6 * time_s / STEP_US))


POLL_S = 0.02


def main() -> None:
    """Serve the camera until SIGTERM."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('kind', choices=('pattern', 'knocks'))
    parser.add_argument('--socket', required=True)
    parser.add_argument('--rate', type=float, default=1e6, help='events per second')
    parser.add_argument('--per-row', type=float, default=1.0, help='events per row')
    parser.add_argument('--frame-interval', type=int, default=0, help='in us, 0 for none')
    parser.add_argument('--reading-interval', type=int, default=0, help='in us, 0 for none')
    options = parser.parse_args()
    stopping = stop_event()
    exact_sleeps()  # Threads of the server inherit it.
    if options.kind == 'pattern':
        pattern = make_pattern(
            options.rate,
            events_per_row=options.per_row,
            frame_interval_us=options.frame_interval,
            reading_interval_us=options.reading_interval,
            wraps=8,
        )
        truth: dict[str, Any] = {'events': len(pattern.events)}
    else:
        pattern, truth = make_slip_pattern()
    camera = PatternCamera('PATTERN1', pattern)
    # The camera counts true time from its construction on the monotonic clock, without skew.
    since_us = camera.true_time_us()
    zero_ns, monotonic_ns = time.time_ns(), time.monotonic_ns()
    server = UsbServer(camera, options.socket)
    freeze_loaded()
    send(ready=True, period_us=pattern.period_us, **truth)
    origin_us = camera.clock_origin_us
    while not stopping.wait(POLL_S):
        if camera.clock_origin_us != origin_us:
            origin_us = camera.clock_origin_us
            later_ns = 1000 * (origin_us - since_us)
            send(origin_ns=zero_ns + later_ns, monotonic_ns=monotonic_ns + later_ns)
    server.close()
    send(periods_lost=camera.player.periods_lost)


if __name__ == '__main__':
    main()
