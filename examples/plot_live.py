# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Plot the force while it is measured: python plot_live.py [SOURCE] [SECONDS] [PICTURE].

Forces that arrive while the plot is drawn are skipped.
"""

import sys
import time

import matplotlib.pyplot as plt

from mixtac import Sensor, SensorError

source, seconds, picture = (*sys.argv[1:], *('virtual:press', '20', '')[len(sys.argv) - 1 :])
figure, axes = plt.subplots()
axes.set_xlabel('camera clock [s]')
axes.set_ylabel('normal force [N]')
(line,) = axes.plot([], [])
times, forces = [], []
with Sensor(source) as sensor:
    end = time.monotonic() + float(seconds)
    drawn = 0.0
    while time.monotonic() < end:
        try:
            reading = sensor.async_read(timeout_ms=10_000)
        except SensorError:  # the end of a recording
            break
        times.append(reading.stamp_us)
        forces.append(reading.force)
        if time.monotonic() > drawn + 0.1:  # ten pictures a second
            line.set_data([(each - times[0]) / 1e6 for each in times], forces)
            axes.relim()
            axes.autoscale_view()
            plt.pause(0.001)
            drawn = time.monotonic()
if picture:
    figure.savefig(picture)
