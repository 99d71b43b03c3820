# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The faults of the recovery benchmark: what is done to the camera, and when it is well again."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from mixtac_sim.usb.faults import Fault, FaultKind

if TYPE_CHECKING:
    from collections.abc import Callable
    from random import Random

    from mixtac_sim.usb.device import VirtualDavis346

    Outage = Callable[[VirtualDavis346, Random], float]

SHORTEST_S, LONGEST_S = 0.05, 1.0
_SEEDS = 1 << 32


def _lasting(kind: FaultKind) -> Outage:
    """Something goes wrong on the running camera for a while."""

    def outage(device: VirtualDavis346, rng: Random) -> float:
        seconds = rng.uniform(SHORTEST_S, LONGEST_S)
        device.inject(Fault(kind, seconds=seconds, seed=rng.randrange(_SEEDS)))
        return time.monotonic() + seconds

    return outage


def _at_once(kind: FaultKind, largest: int) -> Outage:
    """Something goes wrong once, and the camera is well again at once."""

    def outage(device: VirtualDavis346, rng: Random) -> float:
        size, seed = rng.randint(1, largest), rng.randrange(_SEEDS)
        device.inject(Fault(kind, count=1, size=size, seed=seed))
        return time.monotonic()

    return outage


def _ill_after_plugging(kind: FaultKind) -> Outage:
    """The camera is plugged in again, but something is wrong with it for a while."""

    def outage(device: VirtualDavis346, rng: Random) -> float:
        device.unplug()
        time.sleep(rng.uniform(SHORTEST_S, LONGEST_S))
        device.plug_in()
        seconds, delay = rng.uniform(SHORTEST_S, LONGEST_S), rng.uniform(0.01, 0.1)
        device.inject(Fault(kind, seconds=seconds, delay=delay, seed=rng.randrange(_SEEDS)))
        return time.monotonic() + seconds

    return outage


def _replaced(device: VirtualDavis346, rng: Random) -> float:
    seconds = rng.uniform(SHORTEST_S, LONGEST_S)
    serial = f'V{rng.randrange(10**7):07d}'
    device.inject(Fault(FaultKind.UNPLUG, seconds=seconds, serial=serial))
    return time.monotonic() + seconds


def _held_by_another(device: VirtualDavis346, rng: Random) -> float:
    device.unplug()
    time.sleep(rng.uniform(SHORTEST_S, LONGEST_S))
    device.plug_in()
    device.claim('another program')
    time.sleep(rng.uniform(SHORTEST_S, LONGEST_S))
    device.release('another program')
    return time.monotonic()


OUTAGES: dict[str, Outage] = {
    'unplugged': _lasting(FaultKind.UNPLUG),
    'replaced by another': _replaced,
    'held by another program': _held_by_another,
    'data endpoint stalls once': _at_once(FaultKind.STALL_DATA, 1),
    'data endpoint stalls for long': _lasting(FaultKind.STALL_DATA),
    'requests stall': _ill_after_plugging(FaultKind.STALL_CONTROL),
    'requests time out': _ill_after_plugging(FaultKind.TIMEOUT_CONTROL),
    'requests answered late': _ill_after_plugging(FaultKind.DELAY_CONTROL),
    'registers read as garbage': _ill_after_plugging(FaultKind.GARBAGE_REGISTERS),
    'short and odd reads': _lasting(FaultKind.SHORT_READS),
    'bytes lost': _at_once(FaultKind.DROP_BYTES, 1 << 16),
    'garbage in the data': _at_once(FaultKind.GARBAGE_WORDS, 1 << 13),
    'silent for a while': _lasting(FaultKind.FREEZE),
    'silent until restarted': _at_once(FaultKind.FREEZE, 1),
    'reads hang': _lasting(FaultKind.HANG_READS),
    'babble': _at_once(FaultKind.BABBLE, 1),
    'bus error': _at_once(FaultKind.READ_ERROR, 1),
    'clock reset by the cable': _at_once(FaultKind.CLOCK_RESET, 1),
}
"""By name: does something to a camera and returns when it is well again [s, monotonic clock].

They may take as long as the outage. A camera that is silent until restarted counts as well from
the beginning: that the driver has to notice it is part of the recovery.
"""
