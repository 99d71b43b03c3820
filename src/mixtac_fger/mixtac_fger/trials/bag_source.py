# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""rosbag2 bags as a source of training data: live, simulated, or a user's own.

Events and frames are read as the driver reads a recording, so that bags of other camera drivers
work as well. The reference force is brought to the camera clock by the fit beside the bag
(`NAME.clock_fit.json`, written by `mixtac align`) or by the one in the bag.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mixtac_events.arrays import Events
from mixtac_fger.errors import DatasetError
from mixtac_fger.trials.bag_forces import read_forces
from mixtac_fger.trials.trial_arrays import TrialArrays

if TYPE_CHECKING:
    from pathlib import Path

    from mixtac_driver.readings import Frame

_BLOCK = 1 << 20
_SETTLE_US = 900
"""From the end of a frame's readout to its arrival, where the bag does not tell (estimate)."""


@dataclass(frozen=True, slots=True)
class BagSource:
    """A bag.

    Attributes:
        path: Its folder.
        reference: Topic of the reference force.
        described: What a description beside the bag says of it: profile, device_seed and so on.
    """

    path: Path
    reference: str = '/ft_sensor/wrench'
    described: tuple[tuple[str, Any], ...] = ()

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.path.name

    @property
    def origin(self) -> dict[str, Any]:
        """The bag's path and what is known of it."""
        return {'bag': str(self.path)} | dict(self.described) | {'name': self.name}

    def content_key(self) -> str:
        """Return a digest of the bag's files, its clock fit and the topic of its reference.

        Raises:
            DatasetError: They cannot be read.
        """
        digest = hashlib.blake2b(self.reference.encode(), digest_size=16)
        fit = self.path.with_name(f'{self.path.name}.clock_fit.json')
        try:
            files = sorted(self.path.iterdir()) if self.path.is_dir() else [self.path]
            for path in [*files, *([fit] if fit.exists() else [])]:
                with path.open('rb') as file:
                    while block := file.read(_BLOCK):
                        digest.update(block)
        except OSError as error:
            raise DatasetError(f'{self.path} cannot be read ({error}): check the path') from error
        return digest.hexdigest()

    def load(self) -> TrialArrays:
        """Read the bag; about 6 MB of memory per second of recording.

        Raises:
            RecordingError: The bag is damaged or holds no events and frames.
            DatasetError: It has no frames, no force, or no clock fit.
        """
        forces = read_forces(self.path, self.reference)
        return replace(self.load_camera(), truth=forces.truth, reference=forces.reference)

    def load_camera(self) -> TrialArrays:
        """Read events and frames only: a trial of which no force is known.

        Raises:
            RecordingError: The bag is damaged or holds no events and frames.
            DatasetError: It has no frames.
        """
        events, frames, missing = _camera(self.path)
        if not frames:
            raise DatasetError(f'{self.path} holds no frames: record {"image_raw"} as well')
        return TrialArrays(
            events=events,
            frames=np.stack([frame.image for frame, _ in frames]),
            exposure_start_us=np.array([f.exposure_start_us for f, _ in frames], np.int64),
            exposure_end_us=np.array([f.exposure_end_us for f, _ in frames], np.int64),
            arrival_us=np.array([arrival for _, arrival in frames], np.int64),
            truth=None,
            reference=None,
            origin=self.origin,
            missing_packets=missing,
        )


def _camera(path: Path) -> tuple[Events, list[tuple[Frame, int]], int]:
    """Return events, frames with their arrival on the camera clock [us], and lost packets."""
    from mixtac_driver.recordings.playback_parameters import NONE, PlaybackParameters
    from mixtac_driver.recordings.rosbag2 import BagRecording

    recording = BagRecording(path, PlaybackParameters(playback_imu_topic=NONE))
    parts: list[Events] = []
    frames: list[tuple[Frame, int]] = []
    latest_us = 0
    try:
        for piece in recording.pieces(recording.info.start_us):
            if len(piece.events):
                parts.append(piece.events)
            if piece.advances:
                latest_us = max(latest_us, piece.until_us)
            # Received after the packets that precede it in the bag, and never before its readout.
            frames += [
                (frame, max(latest_us, frame.frame_end_us + _SETTLE_US)) for frame in piece.frames
            ]
        missing = recording.counters.packets_missing
    finally:
        recording.close()
    if not parts:
        raise DatasetError(f'{path} holds no events: record the topic events as well')
    events = Events.concatenate(parts)
    if (np.diff(events.t) < 0).any():
        raise DatasetError(f'{path}: the camera clock runs backwards: cut the bag at its reset')
    return events, frames, missing


def bag_sources(folder: Path, reference: str = '/ft_sensor/wrench') -> list[BagSource]:
    """Return the bags of a folder, or the folder itself where it is a bag.

    Args:
        folder: A bag, or a folder of bags with or without `dataset.yaml`.
        reference: Topic of the reference force.

    Raises:
        DatasetError: There are none.
    """
    if (folder / 'metadata.yaml').exists():
        return [BagSource(folder, reference, _described(folder))]
    bags = sorted(path.parent for path in folder.glob('*/metadata.yaml'))
    # A bag that was cut off has its data but no metadata; it is named when it is loaded.
    bags += sorted(
        {p.parent for p in folder.glob('*/*.mcap') if not p.parent.name.startswith('.')} - {*bags}
    )
    if not bags:
        raise DatasetError(f'{folder} holds no bags: give a bag or a folder of bags')
    return [BagSource(path, reference, _described(path)) for path in bags]


def _described(bag: Path) -> tuple[tuple[str, Any], ...]:
    """Return what `dataset.yaml` beside a bag, or a simulated bag itself, says of it."""
    return _described_beside(bag) or _described_inside(bag)


def _described_inside(bag: Path) -> tuple[tuple[str, Any], ...]:
    import yaml

    try:
        metadata = yaml.safe_load((bag / 'metadata.yaml').read_text(encoding='utf-8'))
        custom = metadata['rosbag2_bagfile_information']['custom_data']
        fields: dict[str, Any] = json.loads(custom['mixtac.trial'])
    except (OSError, yaml.YAMLError, ValueError, KeyError, TypeError):
        # Bags of others say nothing of the kind; a damaged one is named when it is loaded.
        return ()
    return tuple(sorted(fields.items()))


def _described_beside(bag: Path) -> tuple[tuple[str, Any], ...]:
    import yaml

    path = bag.parent / 'dataset.yaml'
    try:
        trials = yaml.safe_load(path.read_text(encoding='utf-8'))['trials']
        fields: dict[str, Any] = next((each for each in trials if each['name'] == bag.name), {})
    except FileNotFoundError:
        return ()
    except (OSError, yaml.YAMLError, KeyError, TypeError) as error:
        raise DatasetError(f'{path} cannot be read ({error}): make the data set anew') from error
    return tuple((key, json.loads(json.dumps(value))) for key, value in sorted(fields.items()))
