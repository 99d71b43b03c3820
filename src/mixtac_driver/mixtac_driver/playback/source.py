# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A recording as a source of the driver, in place of a camera."""

from __future__ import annotations

import time
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

from mixtac_driver.davis346.control import CameraControl
from mixtac_driver.davis346.identity import Clocks, Features, Identity
from mixtac_driver.davis346.model import Geometry
from mixtac_driver.davis346.settings import Configuration
from mixtac_driver.decode.state import DecoderCounters
from mixtac_driver.parameters import NO_SEEK
from mixtac_driver.playback.player import PlaybackClock, Player
from mixtac_driver.usb.transport import TransportCounters
from mixtac_events.clock_map import ClockMap
from mixtac_recordings.camera_stream import open_recording
from mixtac_recordings.recording import ReadCounters, RecordingError, Selection

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from mixtac_driver.camera import CameraBatch
    from mixtac_driver.clock import Origin
    from mixtac_driver.parameters import PlaybackParameters
    from mixtac_recordings.recording import Recording, RecordingInfo


class RecordedControl(CameraControl):
    """Takes settings, which change nothing, and refuses requests.

    Args:
        device: Path of the recording.
    """

    def __init__(self, device: str) -> None:
        super().__init__(Configuration())
        self._device = device

    def request_frame(self) -> None:
        """Refuse.

        Raises:
            RecordingError: Always.
        """
        raise self._refusal('take a frame')

    def reset_timestamps(self) -> Origin:
        """Refuse.

        Raises:
            RecordingError: Always.
        """
        raise self._refusal('reset its clock')

    def _refusal(self, request: str) -> RecordingError:
        return RecordingError(f'{self._device} is a recording: no camera is there to {request}')


MICROSECONDS = Clocks(logic=1.0, adc=1.0, usb=1.0)
"""Recorded exposures are in microseconds already."""


def replayed_identity(info: RecordingInfo) -> Identity:
    """Return an identity with the size and colours of the camera; versions are zero.

    Args:
        info: The recording. Its format stands for the chip, which no recording tells, and the name
            of its camera, or else its own, for the serial number.
    """
    return Identity(
        serial=info.camera or info.path.name,
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
    """Plays a recording; offers what the driver needs of a camera (see `source.Source`).

    `batches` is for one thread, everything else may be used from others.

    Args:
        device: Path of the recording.
        playback: How to play it.
        now_ns: Host clock [ns since the Unix epoch].
        pace: The clock to play on; one of its own if None.

    Attributes:
        control: Takes settings of a camera, which change nothing, and refuses requests.
    """

    def __init__(
        self,
        device: str,
        playback: PlaybackParameters,
        *,
        now_ns: Callable[[], int] = time.time_ns,
        pace: PlaybackClock | None = None,
    ) -> None:
        self.control = RecordedControl(device)
        self._device, self._playback, self._now_ns = device, playback, now_ns
        self._pace = pace or PlaybackClock(playback.playback_rate)
        self._recording: Recording | None = None
        self._info: RecordingInfo | None = None
        self._counters = ReadCounters()
        self._identity: Identity | None = None
        self._player: Player | None = None
        if playback.playback_paused:
            self.pause()

    @property
    def clock(self) -> ClockMap:
        """Map from the recorded camera clock [us] to the host's; only fed in real time."""
        return self._player.clock if self._player else ClockMap()

    @property
    def is_master(self) -> bool:
        """True: no cable leads the clock of a recording."""
        return True

    @property
    def identity(self) -> Identity:
        """What made the recording, as far as it tells.

        Raises:
            RecordingError: It was not opened.
        """
        if self._identity is None:
            raise RecordingError(f'{self._device} is not open: call open() first')
        return self._identity

    @property
    def known_identity(self) -> Identity | None:
        """What made the recording; None before it was opened."""
        return self._identity

    @property
    def is_open(self) -> bool:
        """True between `open` and `close`."""
        return self._recording is not None

    @property
    def origin(self) -> Origin | None:
        """What is added to recorded times; None before the first batch."""
        return self._player.origin if self._player else None

    @property
    def clock_resets(self) -> int:
        """Resets of the camera's clock that were recorded."""
        return self._player.disorder.resets if self._player else 0

    @property
    def transport_counters(self) -> TransportCounters:
        """All zero: nothing comes over USB."""
        return TransportCounters()

    @property
    def decoder_counters(self) -> DecoderCounters | None:
        """What was played, and dropped because it lies outside or behind its time."""
        player = self._player
        if player is None:
            return None
        disorder = player.disorder
        counts = {
            **dict.fromkeys((each.name for each in fields(DecoderCounters)), 0),
            **player.counts,
            'timestamps_backwards': disorder.late_events + disorder.unsorted_events,
            'events_outside': self._counters.events_outside,
        }
        return DecoderCounters(**counts)

    def figures(self) -> Mapping[str, object]:
        """Return how the playing goes, or went, for diagnostics."""
        info, counters, player, lag = self._info, self._counters, self._player, self._pace.lag
        if info is None or player is None:
            return {}
        return {
            'recording': info.kind,
            **{f'recorded {kind}': name for kind, name in info.contents},
            'playback': self.playing,
            'playback rate': self._pace.rate,
            'playback position [s]': player.position_s,
            'playback length [s]': info.length_us / 1e6,
            'playback loops': player.loops,
            'playback lag [s]': lag.now_s,
            'playback lag maximum [s]': lag.most_s,
            'playback steps late': lag.late_steps,
            'packets missing in the recording': counters.packets_missing,
        }

    @property
    def playing(self) -> str:
        """What it does: playing, paused or ended."""
        if self._player is not None and self._player.ended:
            return 'ended'
        return 'paused' if self._pace.is_paused else 'playing'

    @property
    def behind_s(self) -> float:
        """How far playing is behind its clock [s]: what is published leaves too late by that."""
        return self._pace.lag.now_s

    def open(self) -> None:
        """Open the recording.

        Raises:
            RecordingError: It cannot be played.
        """
        self._recording = open_recording(Path(self._device), _selection(self._playback))
        self._info, self._counters = self._recording.info, self._recording.counters
        self._identity = replayed_identity(self._info)

    def start(self) -> None:
        """Get ready to play from the start offset; times go on after those handed on before.

        Raises:
            RecordingError: It is not open.
        """
        if self._recording is None:
            raise RecordingError(f'{self._device} is not open: call open() first')
        self._player = Player(
            self._recording,
            self._playback,
            self._pace,
            now_ns=self._now_ns,
            after_us=self._player.latest_us if self._player else None,
        )

    def batches(self) -> Iterator[CameraBatch]:
        """Yield what was recorded, each stretch when it is due, until stopped.

        Raises:
            EndOfStream: Everything was played, and it is not to loop.
            RecordingError: The data are damaged, or the start offset lies beyond the end.
        """
        if self._player is not None:
            yield from self._player.batches()

    def attached(self) -> frozenset[tuple[int, int]]:
        """Return no cameras."""
        return frozenset()

    def apply(self, configuration: Configuration) -> None:
        """Take settings of a camera; they cannot change what was recorded.

        Raises:
            ConfigurationError: A setting is out of range.
        """
        self.control.apply(configuration)

    def reset_timestamps(self) -> None:
        """Refuse.

        Raises:
            RecordingError: Always.
        """
        self.control.reset_timestamps()

    def play_as(self, playback: PlaybackParameters) -> None:
        """Change how it is played.

        Args:
            playback: Rate, loop, pause and seek count at once, the rest at the next `open`.
        """
        before, self._playback = self._playback, playback
        if self._player is not None:
            self._player.playback = playback
        self._pace.set_rate(playback.playback_rate)
        if playback.playback_seek not in {before.playback_seek, NO_SEEK}:
            self.seek(playback.playback_seek)
        if playback.playback_paused:
            self.pause()
        else:
            self.resume()

    def seek(self, seconds: float) -> None:
        """Go on at another place.

        Args:
            seconds: Time after the first event [s]; beyond the end is the end.
        """
        if self._player is not None:
            self._player.seek(seconds)

    def pause(self) -> None:
        """Stand still."""
        self._pace.pause()

    def resume(self) -> None:
        """Go on after `pause`."""
        if self._pace.is_paused:
            self.clock.restart()
            self._pace.resume()

    def request_stop(self) -> None:
        """Make `batches` end soon; returns at once."""
        if self._player is not None:
            self._player.stop()

    def stop(self) -> None:
        """Stop playing."""
        self.request_stop()

    def close(self) -> None:
        """Stop and give the file back."""
        self.request_stop()
        recording, self._recording = self._recording, None
        if recording is not None:
            recording.close()


def _selection(playback: PlaybackParameters) -> Selection:
    return Selection(
        playback.playback_events_topic, playback.playback_image_topic, playback.playback_imu_topic
    )
