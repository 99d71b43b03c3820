# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A vibration against the simulated skin, and what is recorded of one: events and a frame before.

`pressed`: what vibrates stands 0.6 mm deep and never leaves the skin. Its motion to and fro makes
as many events each way, so that the number of events repeats twice per period.

`tapping`: what vibrates touches the skin for a third of each period only, so that there is one
burst per period: that breaks the symmetry. A body that rests on the skin by its weight does so as
soon as its acceleration exceeds g: at 50 Hz from an amplitude of 0.1 mm on.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mixtac_bringup.errors import BagError
from mixtac_bringup.experiments.sizes import PRESET
from mixtac_events.arrays import Events
from mixtac_sim.contact import Mode
from mixtac_sim.presets import preset
from mixtac_sim.segments import Profile, Segment, Tone
from mixtac_sim.sensor import TactileSensor

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

PRESSED, TAPPING = 'pressed', 'tapping'
DEPTH_MM = 0.6
"""How deep what vibrates stands, pressed [mm]."""
SIZES_MM = {PRESSED: (0.05, 0.1, 0.2), TAPPING: (0.8, 1.0)}
"""Pressed: amplitudes, zero to peak; tapping: depths of the dent [mm]."""
HOVER = 0.5
"""Tapping: height of the middle of the motion over the skin, in amplitudes; the rest is depth."""
SETTLED_S = 0.56
SHAKEN_S = (0.65, 1.65)
"""When the vibration is looked at [s]: its fading in has ended, and the gel has settled."""
_NAMED = re.compile(r'(\d+(?:\.\d+)?) ?hz', re.IGNORECASE)


@dataclass(frozen=True, slots=True, eq=False)
class Shaken:
    """What a camera saw of a vibration.

    Attributes:
        events: Sorted events; camera clock [us].
        frame: Image from before it, [260, 346] [DN].
        span_s: When it is looked at [s].
    """

    events: Events
    frame: NDArray[np.uint16]
    span_s: tuple[float, float]


def shake(kind: str, tone_hz: float, size_mm: float, seed: int) -> Shaken:
    """Return a vibration of the simulated sensor.

    Args:
        kind: `PRESSED` or `TAPPING`.
        tone_hz: Its frequency [Hz].
        size_mm: Amplitude, or depth of the dent; see `SIZES_MM` [mm].
        seed: Which sensor and day.
    """
    middle, amplitude = DEPTH_MM, size_mm
    if kind == TAPPING:
        amplitude = size_mm / (1.0 - HOVER)
        middle = -HOVER * amplitude
    tone = Tone(amplitude, tone_hz, 0.0, 0.05)
    end = SHAKEN_S[1]
    segments = (
        Segment(0.0, 0.2, Mode.POSITION, (0.0, 0.2), (min(-0.1, middle), middle)),
        Segment(0.2, SETTLED_S, Mode.POSITION, (0.0,), (middle,)),
        Segment(SETTLED_S, end + 0.1, Mode.POSITION, (0.0,), (middle,), (tone,)),
    )
    sensor = TactileSensor(seed, seed, Profile('vibration', end, segments), preset=preset(PRESET))
    output = sensor.advance(round(1e6 * end))
    still = [f.intensity for f in output.frames if f.frame_end_us < 1e6 * SETTLED_S]
    return Shaken(output.events, still[-1], SHAKEN_S)


def tone_of(name: str) -> float:
    """Return the frequency that the name of a bag says, such as `speaker_120hz` [Hz].

    Raises:
        BagError: It says none.
    """
    found = _NAMED.search(name)
    if found is None:
        raise BagError(f'bag {name} does not say its tone: name it after it, such as speaker_120hz')
    return float(found.group(1))


def recorded(path: Path, settle_s: float = 1.0) -> Shaken:
    """Return a recorded vibration; events are looked at from `settle_s` on, in whole seconds.

    Args:
        path: A bag with events and frames of one tone.
        settle_s: From the begin of the recording until the tone is steady [s].

    Raises:
        RecordingError: The bag is damaged or holds no events.
        BagError: It is too short, or holds no frames.
    """
    from mixtac_driver.recordings.playback_parameters import NONE, PlaybackParameters
    from mixtac_driver.recordings.rosbag2 import BagRecording

    recording = BagRecording(path, PlaybackParameters(playback_imu_topic=NONE))
    parts, frame = [], None
    try:
        for piece in recording.pieces(recording.info.start_us):
            parts.append(piece.events)
            if frame is None and piece.frames:
                frame = piece.frames[0].image
    finally:
        recording.close()
    events = Events.concatenate([part for part in parts if len(part)])
    seconds = int(1e-6 * (events.t[-1] - events.t[0]) - settle_s) if len(events) else 0
    if frame is None or seconds < 1:
        raise BagError(f'{path}: record frames and at least {1.0 + settle_s:g} s of the tone')
    start = 1e-6 * float(events.t[0]) + settle_s
    return Shaken(events, frame, (start, start + seconds))
