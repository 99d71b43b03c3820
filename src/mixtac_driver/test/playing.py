# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Playing recordings through the driver's source."""

from __future__ import annotations

from dataclasses import dataclass, field

from mixtac_core.events.arrays import Events
from mixtac_driver.errors import EndOfStream


@dataclass
class Played:
    """Everything a source gave, on its published clock."""

    events: Events = field(default_factory=Events.empty)
    times: list = field(default_factory=list)
    frames: list = field(default_factory=list)
    frame_times: list = field(default_factory=list)
    ended: bool = False


def play(source, batches=None):
    """Play an open source to its end, or so many batches of it."""
    played, parts = Played(), []
    source.start()
    try:
        for number, batch in enumerate(source.batches(), 1):
            decoded, origin_us = batch.decoded, batch.origin.us
            parts.append(decoded.events.shifted(origin_us))
            played.times.append(batch.time_us)
            played.frames += decoded.frames
            played.frame_times += [frame.middle_us + origin_us for frame in decoded.frames]
            if number == batches:
                break
    except EndOfStream:
        played.ended = True
    played.events = Events.concatenate(parts)
    return played
