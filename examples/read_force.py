# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Read the force: python read_force.py [usb | virtual:press | RECORDING]."""

import sys

from mixtac import Sensor

source = sys.argv[1] if len(sys.argv) > 1 else 'virtual:press'
with Sensor(source) as sensor:
    for number in range(1000):
        reading = sensor.read()  # 500 a second
        if number % 50 == 0:
            seconds = reading.stamp_us / 1e6
            print(f'{seconds:.3f} s: {reading}')
