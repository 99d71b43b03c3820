# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The virtual sensor's whole chain in one thread, as fast as it goes."""

from __future__ import annotations

import struct
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from mixtac_sim.datasets.trial_stream import TrialStream
from mixtac_sim.usb.descriptors import DATA_ENDPOINT, serial_number
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.usb.errors import UsbTimeout
from mixtac_sim.usb.registers import Aps, Dvs, Imu, Module, Mux, Usb

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mixtac_sim.datasets.trial_spec import TrialSpec
    from mixtac_sim.datasets.trial_stream import Stretch

TICK_US: Final = 1_000
"""The virtual sensor hands over what is due every millisecond."""
READ_BYTES: Final = 1 << 22
_TO_DEVICE, _WRITE_MANY = 0x40, 0xC2
_RUN: Final = (
    (Module.MUX, Mux.RUN_CHIP),
    (Module.USB, Usb.RUN),
    (Module.MUX, Mux.TIMESTAMP_RUN),
    (Module.MUX, Mux.RUN),
    (Module.DVS, Dvs.RUN),
    (Module.APS, Aps.RUN),
    (Module.IMU, Imu.RUN_ACCEL),
    (Module.IMU, Imu.RUN_GYRO),
    (Module.IMU, Imu.RUN_TEMPERATURE),
)


@dataclass(frozen=True, slots=True)
class ChainRun:
    """One run of the chain.

    Attributes:
        simulated_s: Simulated time [s].
        wall_s: Time it took [s].
        cpu_s: Processor time it took [s].
        events: Events simulated.
        octets: Bytes that came out of the camera.
    """

    simulated_s: float
    wall_s: float
    cpu_s: float
    events: int
    octets: int


class Chain:
    """Mechanics, pixels and frames of a trial, sent as USB words by the virtual camera.

    Args:
        spec: The trial.
    """

    def __init__(self, spec: TrialSpec) -> None:
        self._trial = TrialStream(spec)
        self._camera = running_camera(serial_number(spec.device_seed))

    def run(self) -> ChainRun:
        """Run the whole trial and take the time; only once.

        Raises:
            UsbTimeout: The camera has lost its tongue.
        """
        wall_s, cpu_s = time.perf_counter(), time.process_time()
        events = octets = last_us = 0
        for stretch in self._trial.stretches():
            octets += self._send(stretch)
            events += len(stretch.sensor.events)
            last_us = stretch.end_us
        wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
        return ChainRun(1e-6 * last_us, wall_s, cpu_s, events, octets)

    def _send(self, stretch: Stretch) -> int:
        camera, octets = self._camera, 0
        camera.submit(stretch.sensor.events, stretch.sensor.frames, stretch.readings)
        for now_us in range(stretch.start_us + TICK_US, stretch.end_us + 1, TICK_US):
            camera.advance(now_us)
            try:
                octets += len(camera.read_bulk(DATA_ENDPOINT, READ_BYTES, 0.0))
            except UsbTimeout:
                continue
        return octets


def running_camera(serial: str) -> VirtualDavis346:
    """Return a virtual camera with everything on, whose clock stands at zero."""
    camera = VirtualDavis346(serial, clock=lambda: 0)
    settings: Sequence[tuple[int, int, int]] = [
        *((int(module), int(param), 1) for module, param in _RUN),
        (int(Module.USB), int(Usb.EARLY_PACKET_DELAY), 0),
    ]
    data = b''.join(struct.pack('>BBI', *setting) for setting in settings)
    camera.control(_TO_DEVICE, _WRITE_MANY, len(settings), 0, data)
    return camera
