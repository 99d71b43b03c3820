# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A recording as a source of the driver, instead of a camera."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from mixtac_driver.camera import CameraBatch, SourceStatus
from mixtac_driver.davis346.control import PixelFilter
from mixtac_driver.davis346.model import DAVIS346, Clocks, Features, Geometry, Identity
from mixtac_driver.parameters import NO_SEEK, DriverParameters
from mixtac_driver.playback.player import PlaybackClock, Player
from mixtac_events.clock_map import ClockMap
from mixtac_recordings.camera_stream import open_recording
from mixtac_recordings.recording import (
    ReadCounters,
    Recording,
    RecordingError,
    RecordingInfo,
    Selection,
)

MICROSECONDS = Clocks(logic=1.0, adc=1.0, usb=1.0)
"""Recorded exposures are in microseconds already."""
BEHIND_S = 0.1
"""Delay of playback [s] from which on it is reported."""


def replayed_identity(info: RecordingInfo) -> Identity:
    """Return an identity with the size and colours of the recorded camera; versions are zero.

    Args:
        info: The recording. Its format stands for the chip, which is not recorded.
    """
    return Identity(
        model=replace(DAVIS346, name=info.kind, chips=(), width=info.width, height=info.height),
        serial=info.camera.rpartition('_')[2],
        firmware=(0, 0),
        logic=(0, 0),
        chip=info.kind,
        is_master=True,
        clocks=MICROSECONDS,
        geometry=Geometry(
            dvs_columns=info.width,
            dvs_rows=info.height,
            dvs_inverted=False,
            aps_columns=info.width,
            aps_rows=info.height,
            aps_inverted=False,
        ),
        imu_type=0,
        imu_flips=(False, False, False),
        features=Features(color_filter=info.color_filter),
    )


class RecordedSource:
    """Plays a recording (see `mixtac_driver.source.Source`).

    `batches` is for one thread, everything else may be used from others.

    Args:
        parameters: Path of the recording (`device`) and how to play it (`playback_*`).
        now_ns: Host clock [ns since the Unix epoch].

    Attributes:
        control: None: a recording takes no requests.
    """

    def __init__(
        self,
        parameters: DriverParameters,
        now_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self.control = None
        self._device, self._p, self._now_ns = parameters.device, parameters, now_ns
        self._pace = PlaybackClock(parameters.playback_rate)
        self._recording: Recording | None = None
        self._info: RecordingInfo | None = None
        self._counters = ReadCounters()
        self._player: Player | None = None
        if parameters.playback_paused:
            self._pace.pause()

    def status(self) -> SourceStatus:
        """Return the state of playback."""
        player, lag_s = self._player, self._pace.lag.now_s
        damage = self._info.damage if self._info else ''
        return SourceStatus(
            is_open=self._recording is not None,
            identity=replayed_identity(self._info) if self._info else None,
            clock=player.clock if player else ClockMap(),
            origin=player.origin if player else None,
            losses={
                'events outside': self._counters.events_outside,
                'timestamps backwards': player.disorder.out_of_order if player else 0,
            },
            figures=self._figures(),
            paused=self._pace.is_paused and not (player and player.ended),
            trouble=f'playback is {lag_s:.1f} s behind' if lag_s > BEHIND_S else damage,
        )

    def _figures(self) -> Mapping[str, object]:
        info, player, pace = self._info, self._player, self._pace
        if info is None or player is None:
            return {}
        playing = 'paused' if pace.is_paused else 'playing'
        return {
            'recording': info.kind,
            **{f'recorded {kind}': name for kind, name in info.contents},
            'playback': 'ended' if player.ended else playing,
            'playback rate': pace.rate,
            'playback position [s]': player.position_s,
            'playback length [s]': info.length_us / 1e6,
            'playback loops': player.loops,
            'playback lag [s]': pace.lag.now_s,
            'playback lag maximum [s]': pace.lag.most_s,
            'playback steps late': pace.lag.late_steps,
            'packets missing in the recording': self._counters.packets_missing,
            'clock resets': player.disorder.resets,
        }

    def attached(self) -> frozenset[tuple[int, int]]:
        """Return no cameras."""
        return frozenset()

    def open(self) -> None:
        """Open the recording.

        Raises:
            RecordingError: It cannot be played.
        """
        p = self._p
        wanted = Selection(p.playback_events_topic, p.playback_image_topic, p.playback_imu_topic)
        self._recording = open_recording(Path(self._device), wanted)
        self._info, self._counters = self._recording.info, self._recording.counters

    def start(self) -> None:
        """Prepare playback from the start offset; times continue after those of the stream before.

        Raises:
            RecordingError: It is not open.
        """
        if self._recording is None:
            raise RecordingError(f'{self._device} is not open', remedy='call open() first')
        self._player = Player(
            self._recording,
            self._p,
            self._pace,
            now_ns=self._now_ns,
            after_us=self._player.latest_us if self._player else None,
        )

    def batches(self) -> Iterator[CameraBatch]:
        """Yield the recorded data, each stretch when it is due, until stopped.

        Raises:
            EndOfStream: Everything was played, and playback does not loop.
            RecordingError: The data are damaged, or the start offset lies beyond the end.
        """
        if self._player is not None:
            yield from self._player.batches()

    def apply(self, parameters: DriverParameters, pixel_filter: PixelFilter = ()) -> None:
        """Change how the recording is played: rate, loop, pause and seek, at once.

        Args:
            parameters: All of them; settings of a camera have no effect.
            pixel_filter: Has no effect.
        """
        del pixel_filter
        before, self._p = self._p, parameters
        if self._player is not None:
            self._player.playback = parameters
        if parameters.playback_seek not in {before.playback_seek, NO_SEEK}:
            self.seek(parameters.playback_seek)
        self._pace.set_rate(parameters.playback_rate)
        if parameters.playback_paused:
            self._pace.pause()
        elif self._pace.is_paused:
            if self._player is not None:
                self._player.clock.restart()
            self._pace.resume()

    def seek(self, seconds: float) -> None:
        """Continue at another position.

        Args:
            seconds: Time after the first event [s]; beyond the end stands for the end.
        """
        if self._player is not None:
            self._player.seek(seconds)

    def request_stop(self) -> None:
        """Make `batches` end soon; returns at once."""
        if self._player is not None:
            self._player.stop()

    def close(self) -> None:
        """Stop playback and close the file."""
        self.request_stop()
        recording, self._recording = self._recording, None
        if recording is not None:
            recording.close()
