# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the driver node that count when it plays a recording."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_node.parameters import parameter

NO_SEEK = -1.0
NONE = 'none'
"""Name of a topic that stands for: do not play this kind of data."""

_WHICH = 'empty takes the only one, none plays none'


@dataclass(frozen=True)
class PlaybackParameters:
    """How a recording is played."""

    playback_rate: float = parameter(
        1.0,
        'Speed of a recording: 1 is real time, 0 as fast as its subscribers allow',
        minimum=0.0,
        maximum=1000.0,
    )
    playback_loop: bool = parameter(
        False,
        'A recording starts again at its end; stamps go on by its length and 1 ms',
    )
    playback_paused: bool = parameter(False, 'A recording stands still')
    playback_start: float = parameter(
        0.0,
        'Where in a recording to begin, also when looping',
        unit='s',
        minimum=0.0,
        maximum=1e9,
        read_only=True,
    )
    playback_seek: float = parameter(
        NO_SEEK,
        'A new value jumps there, counted from the first event; stamps never go back: after a jump '
        'to an earlier place they go on 1 ms after the latest; -1 does nothing; without effect '
        'once a recording has ended',
        unit='s',
        minimum=NO_SEEK,
        maximum=1e9,
    )
    playback_restamp: bool = parameter(
        False,
        'Stamps are moved to the time of playing (at the start, at loops and jumps) instead of '
        'being those recorded',
        read_only=True,
    )
    playback_clock: bool = parameter(
        False,
        'The recorded camera clock is published on /clock, for nodes with use_sim_time; the driver '
        'itself stays on the host clock',
        read_only=True,
    )
    playback_events_topic: str = parameter(
        '', f'Which topic or stream of events to play; {_WHICH}', read_only=True
    )
    playback_image_topic: str = parameter(
        '', f'Which topic or stream of frames to play; {_WHICH}', read_only=True
    )
    playback_imu_topic: str = parameter(
        '', f'Which topic or stream of inertial samples to play; {_WHICH}', read_only=True
    )
