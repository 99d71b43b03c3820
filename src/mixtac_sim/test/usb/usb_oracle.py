# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A running virtual camera on a clock that stands, and a plain decoder of what it sends."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

import numpy as np
from usb.core import USBTimeoutError

from mixtac_core.events.arrays import Events
from mixtac_sim.pixels.aps import ApsFrame
from mixtac_sim.usb.device import VirtualDavis346

MUX, DVS, APS, IMU, USB = 0, 1, 2, 3, 9


@dataclass
class Decoded:
    """What a plain reading of the protocol table gives."""

    events: list = field(default_factory=list)
    specials: list = field(default_factory=list)
    columns: list = field(default_factory=list)
    regions: list = field(default_factory=list)
    exposures: list = field(default_factory=list)
    imu: list = field(default_factory=list)
    wraps: list = field(default_factory=list)
    stamps: list = field(default_factory=list)


def decode(words):
    """Decode word by word in plain Python."""
    out = Decoded()
    base = t = row = 0
    for word in (int(w) for w in words):
        kind, payload = word >> 12, word & 0xFFF
        if word & 0x8000:
            t = base + (word & 0x7FFF)
            out.stamps.append(t)
        elif kind == 0:
            out.specials.append((payload, t))
            if payload == 1:
                base = t = 0
            elif payload in {11, 12}:
                out.columns.append((payload, []))
            elif payload in {8, 9}:
                out.regions.append([])
                out.exposures.append([])
            elif payload == 5:
                out.imu.append([])
            elif payload == 7:
                out.imu[-1].append(t)
        elif kind == 1:
            row = payload
        elif kind in {2, 3}:
            out.events.append((t, row, payload, kind == 3))
        elif kind == 4:
            out.columns[-1][1].append(payload & 0x3FF)
        elif kind == 5:
            code, data = payload >> 8, payload & 0xFF
            {0: out.imu, 3: out.imu, 1: out.regions, 2: out.regions}[code][-1].append(data)
        elif kind == 6:
            out.exposures[-1].append(payload & 0x3FF)
        else:
            out.wraps.append(payload)
            base += payload * 0x8000
            t = base
    return out


def write(device, *settings):
    data = b''.join(struct.pack('>BBI', *setting) for setting in settings)
    device.control(0x40, 0xC2, len(settings), 0, data)


def camera(**options):
    """Return a camera on a clock that stands at zero, running, with every source switched on."""
    now = options.pop('now', [0])
    device = VirtualDavis346('V0000001', clock=lambda: now[0], **options)
    write(device, (MUX, 3, 1), (USB, 0, 1), (MUX, 1, 1), (MUX, 0, 1), (USB, 1, 0))
    write(device, (DVS, 3, 1), (APS, 4, 1), (IMU, 2, 1), (IMU, 3, 1), (IMU, 4, 1))
    return device


def drain(device):
    data = b''
    while True:
        try:
            data += device.read_bulk(0x82, 1 << 20, 0.0)
        except USBTimeoutError:
            return np.frombuffer(data, '<u2')


def events_of(rows):
    t, x, y, p = (list(c) for c in zip(*rows, strict=True)) if rows else ([], [], [], [])
    return Events(
        np.array(t, np.int64), np.array(x, np.uint16), np.array(y, np.uint16), np.array(p, bool)
    )


def some_frame(start=1000, seed=0):
    rng = np.random.default_rng(seed)
    reset = rng.integers(500, 1024, (260, 346)).astype(np.uint16)
    signal = rng.integers(1, 500, (260, 346)).astype(np.uint16)
    return ApsFrame(start, start + 5000, start + 9000, start + 14_000, reset, signal)
