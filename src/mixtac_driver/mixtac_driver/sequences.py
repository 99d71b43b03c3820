# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Starting, stopping and resetting the clock of a camera, in the order that cameras know."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mixtac_driver.register_writes import run_writes
from mixtac_driver.registers import (
    Aps,
    Dvs,
    ExternalInput,
    Imu,
    Module,
    Mux,
    Usb,
    Write,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from mixtac_driver.configuration import Configuration
    from mixtac_driver.protocol import Protocol

QUIET_S = 0.01
"""Time for data still on its way after everything was stopped."""
BIASES_SETTLE_S = 0.2
LOGIC_SETTLE_S = 0.05

STOP_WRITES = (
    Write(Module.DVS, Dvs.RUN, 0),
    Write(Module.APS, Aps.RUN, 0),
    Write(Module.IMU, Imu.RUN_ACCELEROMETER, 0),
    Write(Module.IMU, Imu.RUN_GYROSCOPE, 0),
    Write(Module.IMU, Imu.RUN_TEMPERATURE, 0),
    Write(Module.EXTERNAL_INPUT, ExternalInput.RUN_DETECTOR, 0),
    Write(Module.MUX, Mux.RUN, 0),
    Write(Module.MUX, Mux.TIMESTAMP_RUN, 0),
    Write(Module.USB, Usb.RUN, 0),
)
CHIP_OFF = Write(Module.MUX, Mux.RUN_CHIP, 0)


@dataclass(frozen=True, slots=True)
class Origin:
    """Host time at which the camera's clock read zero.

    Attributes:
        host_ns: Host time [ns since the Unix epoch], a multiple of 1000.
        uncertainty_ns: Greatest error of it [ns].
    """

    host_ns: int
    uncertainty_ns: int

    @property
    def us(self) -> int:
        """Host time [us since the Unix epoch]; add it to camera times to publish them."""
        return self.host_ns // 1000


def start(
    protocol: Protocol,
    configuration: Configuration,
    begin_reading: Callable[[], None],
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Bring a configured camera from any state to streaming.

    Args:
        protocol: Register access.
        configuration: Says which sensors run.
        begin_reading: Clears the data endpoint and begins to read it; data flow soon after.
        sleep: Waits a number of seconds.

    Raises:
        UsbError: A request failed.
    """
    protocol.write_each([*STOP_WRITES, CHIP_OFF])
    sleep(QUIET_S)
    begin_reading()
    protocol.write(Module.MUX, Mux.RUN_CHIP, 1)
    sleep(BIASES_SETTLE_S)
    protocol.write(Module.USB, Usb.RUN, 1)
    protocol.write(Module.MUX, Mux.TIMESTAMP_RUN, 1)
    protocol.write(Module.MUX, Mux.RUN, 1)
    sleep(LOGIC_SETTLE_S)
    protocol.write_each([write for write in run_writes(configuration) if write.value])


def stop(protocol: Protocol, end_reading: Callable[[], None]) -> None:
    """Stop streaming and switch the chip off.

    Args:
        protocol: Register access.
        end_reading: Ends the reads of the data endpoint.

    Raises:
        UsbError: A request failed; reading was ended all the same.
    """
    try:
        protocol.write_each(STOP_WRITES)
    finally:
        end_reading()
    protocol.write_each([CHIP_OFF])


def reset_timestamps(protocol: Protocol, now_ns: Callable[[], int] = time.time_ns) -> Origin:
    """Set the camera's clock to zero and say when that was.

    The reset happens between two readings of the host clock; their middle is taken.

    Args:
        protocol: Register access.
        now_ns: Host clock [ns since the Unix epoch].

    Raises:
        UsbError: The request failed.
    """
    before = now_ns()
    protocol.write_at_once(
        [Write(Module.MUX, Mux.TIMESTAMP_RESET, 1), Write(Module.MUX, Mux.TIMESTAMP_RESET, 0)]
    )
    after = now_ns()
    middle_us = (before + after + 1000) // 2000
    return Origin(middle_us * 1000, (after - before) // 2 + 500)
