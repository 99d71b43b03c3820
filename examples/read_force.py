# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Read the force: python read_force.py [usb | virtual:press | RECORDING]."""

import sys

from mixtac import Sensor, SensorError

source = sys.argv[1] if len(sys.argv) > 1 else 'virtual:press'
with Sensor(source) as sensor:
    try:
        for number in range(1000):
            reading = sensor.read()  # 500 a second
            if number % 50 == 0:
                print(f'{reading.stamp_us / 1e6:.3f} s: {reading}')
    except SensorError as error:  # the end of a recording
        print(error)
