# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the driver says of itself on `/diagnostics`."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

from mixtac_driver.backend import is_real
from mixtac_driver.supervisor import State
from mixtac_node.diagnostics import ERROR, OK, WARN, Status
from mixtac_node.rates import RateMeter, RecentValues

if TYPE_CHECKING:
    from mixtac_driver.camera import Davis346
    from mixtac_driver.clock_map import ClockEstimate
    from mixtac_driver.supervisor import Supervisor

LOSSES = (
    'events_outside',
    'events_without_row',
    'rows_outside',
    'timestamps_backwards',
    'specials_unknown',
    'misc_unknown',
    'samples_unexpected',
    'aps_unexpected',
    'frames_dropped',
    'imu_dropped',
    'imu_unexpected',
    'bytes_dropped',
    'bytes_lost',
)
"""Counters of the decoder that stay at zero on a sound stream."""


class DriverStatus:
    """Gathers the figures of a running driver.

    The meters are fed by the thread that publishes and read by the one that reports.

    Args:
        device: Device string.
        camera: The camera.
        supervisor: What keeps it streaming.

    Attributes:
        events: Events published.
        packets: Packets published.
        frames: Frames published.
        samples: Inertial samples decoded.
        ages_s: From arrival to publication of packets [s].
        clock: Latest figures of the clock map, or None.
        temperature: Latest temperature of the camera [degrees Celsius], NaN without.
    """

    def __init__(self, device: str, camera: Davis346, supervisor: Supervisor) -> None:
        self.events, self.packets = RateMeter(), RateMeter()
        self.frames, self.samples = RateMeter(), RateMeter()
        self.ages_s = RecentValues()
        self.clock: ClockEstimate | None = None
        self.temperature = math.nan
        self._device, self._camera, self._supervisor = device, camera, supervisor
        self._bytes = RateMeter()
        self._lost_before = 0

    def status(self) -> Status:
        """Return the current status; rates are over the time since the last call."""
        values = {
            'state': self._supervisor.state.value,
            'device': self._device,
            'simulated': not is_real(self._device),
            **self._identity(),
            **self._rates(time.monotonic()),
            **self._losses(),
            **self._clock(),
            'failures': self._supervisor.failures,
        }
        lost = self._lost()
        fresh, self._lost_before = lost > self._lost_before, lost
        if self._supervisor.state is not State.STREAMING:
            return Status(ERROR, self._supervisor.error or 'no stream yet', values)
        kind = 'streaming' if is_real(self._device) else 'streaming from a simulated camera'
        if fresh:
            return Status(WARN, f'{kind}, but data were lost or damaged', values)
        return Status(OK, kind, values)

    def _identity(self) -> dict[str, object]:
        identity = self._camera.known_identity
        if identity is None:
            return {}
        return {
            'serial': identity.serial,
            'chip': identity.chip,
            'firmware': '.'.join(map(str, identity.firmware)),
            'logic': '.'.join(map(str, identity.logic)),
        }

    def _rates(self, now_s: float) -> dict[str, object]:
        usb = self._camera.transport_counters
        self._bytes.total = usb.size
        rates: dict[str, object] = {
            'events per second': self.events.read(now_s),
            'packets per second': self.packets.read(now_s),
            'frames per second': self.frames.read(now_s),
            'imu samples per second': self.samples.read(now_s),
            'usb bytes per second': max(self._bytes.read(now_s), 0.0),
            'packet age median [s]': self.ages_s.quantile(0.5),
            'packet age p99 [s]': self.ages_s.quantile(0.99),
            'usb queue [bytes]': usb.queued_size,
            'usb queue maximum [bytes]': usb.most_queued_size,
        }
        if not math.isnan(self.temperature):
            rates['temperature [C]'] = self.temperature
        return rates

    def _losses(self) -> dict[str, object]:
        usb, decoder = self._camera.transport_counters, self._camera.decoder_counters
        counted = decoder.as_dict() if decoder else {}
        return {
            'usb transfers dropped': usb.dropped_transfers,
            'usb stalls': usb.stalls,
            **{name.replace('_', ' '): counted[name] for name in LOSSES if name in counted},
        }

    def _lost(self) -> int:
        decoder = self._camera.decoder_counters
        damaged = sum(getattr(decoder, name) for name in LOSSES) if decoder else 0
        return damaged + self._camera.transport_counters.dropped_transfers

    def _clock(self) -> dict[str, object]:
        origin, clock = self._camera.origin, self.clock
        if origin is None or clock is None:
            return {}
        return {
            'clock origin uncertainty [us]': origin.uncertainty_ns / 1000,
            'clock offset [us]': clock.offset_us - origin.us,
            'clock skew [ppm]': clock.skew_ppm,
            'clock residual [us]': clock.residual_us,
            'clock steps': clock.steps,
            'clock resets': self._camera.clock_resets,
            'clock master': self._camera.is_master,
        }
