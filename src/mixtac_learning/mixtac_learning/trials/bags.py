# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trials from rosbag2 bags: live, simulated, or recorded with another driver.

Events and frames are read as the driver reads a recording. The reference force is brought to the
camera clock by the fit beside the bag (`NAME.clock_fit.json`, written by `mixtac align`) or by the
fit in the bag.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.readings import Frame
from mixtac_core.node.topics import REFERENCE, stamp_to_ns
from mixtac_core.recordings.bag import BagFile, custom_data, find_bags, fit_path
from mixtac_core.recordings.camera_stream import BagRecording
from mixtac_core.recordings.dataset import described_trial, folder_facts
from mixtac_core.recordings.recording import NONE, DamagedRecordingError, Selection
from mixtac_fger.alignment.bags import read_fit, stuck
from mixtac_fger.alignment.clock_fit import ClockFit
from mixtac_fger.streaming import JUMP_US
from mixtac_learning.trials.trial import DatasetError, ForceLabel, SimulatedSource, TrialArrays


def label_on_camera_clock(
    t_us: NDArray[np.float64], values: NDArray[np.float64], what: str
) -> tuple[ForceLabel, ForceLabel]:
    """Return the normal force and the force across it in the order of time.

    Args:
        t_us: Camera clock [us], [n].
        values: Force x, y, z [N] and torque x, y, z [Nm], [n, 6].
        what: Name of the topic, for messages.

    Raises:
        DatasetError: There are too few samples, or one is not finite.
    """
    if len(values) < 2:
        raise DatasetError(f'{what} holds {len(values)} samples: record the force sensor as well')
    if not np.isfinite(values[:, 2]).all():
        raise DatasetError(f'{what} holds values that are not finite: check the force sensor')
    order = np.argsort(t_us, kind='stable')
    times, sorted_values = t_us[order], values[order]
    across = ForceLabel(times, sorted_values[:, [0, 1, 5]])
    return ForceLabel(times, sorted_values[:, 2].copy()), across


def host_to_camera_us(
    host_ns: NDArray[np.int64], pairs: list[tuple[int, int]]
) -> NDArray[np.float64]:
    """Return host times on the camera clock [us] by the pairs that the driver published.

    Args:
        host_ns: Host clock [ns].
        pairs: Host time [ns] and camera time [ns], in the order of time.

    Raises:
        DatasetError: There are no pairs.
    """
    if not pairs:
        raise DatasetError('the bag has no camera_clock, so host times cannot be converted')
    table = np.array(pairs, np.int64)
    since = (host_ns - table[0, 0]) / 1000.0
    host, ahead = (table[:, 0] - table[0, 0]) / 1000.0, (table[:, 1] - table[:, 0]) / 1000.0
    # A line: single pairs carry the jitter of USB transfers.
    offset = np.polyval(np.polyfit(host, ahead, min(len(table) - 1, 1)), since)
    return np.asarray(table[0, 0] / 1000.0 + since + offset, np.float64)


CLOCK_FIT = 'mixtac_msgs/msg/ClockFit'
_TRUE_FORCE = '/truth/wrench'
_TRUE_FIT = '/truth/clock_fit'
_CAMERA_CLOCK = '/camera_clock'


def read_forces(
    path: Path, reference: str, *, incomplete: bool = False
) -> tuple[ForceLabel | None, ForceLabel | None, ForceLabel | None]:
    """Return the true and the measured normal force of a bag on the camera clock.

    The third value is the true force across the normal. A force is None if the bag does not have
    it, and the measured one also without a clock fit. A fit beside the bag is preferred to one
    inside, and a computed fit to the true one of a simulated bag.

    Args:
        path: The bag.
        reference: Topic of the reference force.
        incomplete: Read the intact part of a bag that was cut off.

    Raises:
        RecordingError: The bag is damaged.
        DatasetError: It has neither a true force nor a reference that can be aligned.
        AlignmentError: A clock fit beside it or inside is damaged.
    """
    pairs: list[tuple[int, int]] = []
    fits: dict[bool, ClockFit] = {}
    with BagFile(path) as bag:
        clocks = [t for t, k in bag.types.items() if t.endswith(_CAMERA_CLOCK) or k == CLOCK_FIT]
        for topic, _, message in bag.messages(*clocks):
            if topic.endswith(_CAMERA_CLOCK):
                pairs.append((stamp_to_ns(message.header.stamp), stamp_to_ns(message.time_ref)))
            else:
                fits[topic.endswith(_TRUE_FIT)] = ClockFit.from_fields(vars(message))
        wanted = [t for t in bag.types if t == reference or t.endswith(_TRUE_FORCE)]
        forces = {t != reference: bag.wrenches(t) for t in wanted if bag.counts[t]}
        # Damaged chunks are found while the bag is read.
        if bag.damage and not incomplete:
            raise DamagedRecordingError(f'{path}: {bag.damage}', remedy='run `mixtac repair`')
    made = read_fit(path) if fit_path(path).exists() else fits.get(False)
    fit = made or fits.get(True)
    truth = measured = across = None
    if True in forces:
        stamps, values = forces[True]
        t_us = host_to_camera_us(stamps, pairs)
        truth, across = label_on_camera_clock(t_us, values, f'{path} topic ...{_TRUE_FORCE}')
    if False in forces and fit is not None:
        stamps, values = forces[False]
        t_us = fit.stamp_to_camera_us(stamps)
        measured, _ = label_on_camera_clock(t_us, values, f'{path} topic {reference}')
    if truth is None and measured is None:
        if False in forces:
            raise DatasetError(
                f'{path} has no clock fit to place {reference}', remedy=f'run `mixtac align {path}`'
            )
        raise DatasetError(f'{path} has no force', remedy=f'record {reference} beside the camera')
    return truth, measured, across


_BLOCK = 1 << 20
_SETTLE_US = 900
"""From the end of a frame's readout to its arrival, if the bag does not contain it (estimate)."""


@dataclass(frozen=True, slots=True)
class BagSource:
    """A bag.

    Attributes:
        path: Its folder.
        reference: Topic of the reference force.
        described: Facts from a description of the bag: profile, device_seed and so on.
        incomplete: Read the intact part of a bag that was cut off.
        shown: Name of the trial; empty for that of the folder.
    """

    path: Path
    reference: str = REFERENCE
    described: dict[str, Any] = field(default_factory=dict, hash=False)
    incomplete: bool = False
    shown: str = ''

    def damage(self) -> str:
        """Return the missing parts of the bag and a reference that does not move; empty if none.

        Raises:
            RecordingError: Nothing of it can be read.
        """
        with BagFile(self.path) as bag:
            named = [self.reference] if self.reference in bag.types else []
            still = [stuck(t_ns / 1e9, forces[:, 2]) for t_ns, forces in map(bag.wrenches, named)]
            return '; '.join(filter(None, (bag.damage, *still)))

    @property
    def name(self) -> str:
        """Name of the trial."""
        return self.shown or self.path.name

    @property
    def origin(self) -> dict[str, Any]:
        """Path and known properties of the bag."""
        return {'bag': str(self.path)} | self.described | {'name': self.name}

    def content_key(self) -> str:
        """Return a digest of the bag's files and description, clock fit and reference topic."""
        digest = hashlib.blake2b(self.reference.encode(), digest_size=16)
        digest.update(json.dumps(self.described, sort_keys=True, default=str).encode())
        fit = fit_path(self.path)
        files = sorted(self.path.iterdir()) if self.path.is_dir() else [self.path]
        for path in [*files, *([fit] if fit.exists() else [])]:
            with path.open('rb') as file:
                while block := file.read(_BLOCK):
                    digest.update(block)
        return digest.hexdigest()

    def load(self) -> TrialArrays:
        """Read the bag; about 6 MB of memory per second of recording.

        Raises:
            RecordingError: The bag is damaged or holds no events and frames.
            DatasetError: It has no frames, no force, or no clock fit.
        """
        truth, reference, across = read_forces(
            self.path, self.reference, incomplete=self.incomplete
        )
        events, frames, gaps = _camera(self.path)
        if not frames:
            raise DatasetError(f'{self.path} holds no frames: record image_raw as well')
        return TrialArrays(
            events=events,
            frames=np.stack([frame.image for frame, _ in frames]),
            exposure_start_us=np.array([f.exposure_start_us for f, _ in frames], np.int64),
            exposure_end_us=np.array([f.exposure_end_us for f, _ in frames], np.int64),
            arrival_us=np.array([arrival for _, arrival in frames], np.int64),
            truth=truth,
            reference=reference,
            across=across,
            origin=self.origin,
            gaps_us=gaps,
        )


TrialSource = SimulatedSource | BagSource
"""A trial that is loaded when it is needed."""


def _camera(path: Path) -> tuple[Events, list[tuple[Frame, int]], list[tuple[int, int]]]:
    """Return events, frames with their arrival, and gaps between packets [us, camera clock]."""
    recording = BagRecording(path, Selection(imu=NONE))
    parts: list[Events] = []
    frames: list[tuple[Frame, int]] = []
    gaps: list[tuple[int, int]] = []
    latest_us = missing = 0
    try:
        for piece in recording.pieces():
            if len(piece.events):
                parts.append(piece.events)
            if piece.advances:
                lost, missing = missing, recording.counters.packets_missing
                hole_us = piece.start_us - latest_us if latest_us else 0
                if hole_us > (0 if lost < missing else JUMP_US):
                    gaps.append((latest_us, piece.start_us))
                latest_us = max(latest_us, piece.until_us)
            # Received after the packets that precede it in the bag, and never before its readout.
            frames += [
                (frame, max(latest_us, frame.frame_end_us + _SETTLE_US)) for frame in piece.frames
            ]
    finally:
        recording.close()
    if not parts:
        raise DatasetError(f'{path} holds no events: record the topic events as well')
    events = Events.concatenate(parts)
    if (np.diff(events.t) < 0).any():
        raise DatasetError(f'{path}: the camera clock runs backwards: cut the bag at its reset')
    return events, frames, gaps


def bag_sources(folder: Path, reference: str = REFERENCE) -> list[BagSource]:
    """Return the bags of a folder, or the folder itself where it is a bag.

    Args:
        folder: A bag, or a folder of bags. Bags without `dataset.yaml` have the profile and the
            split that their folders are named after.
        reference: Topic of the reference force.

    Raises:
        DatasetError: The folder has no bags.
    """
    bags = find_bags(folder)
    if not bags:
        raise DatasetError(f'{folder} holds no bags: give a bag or a folder of bags')
    return [
        BagSource(bag, reference, folder_facts(bag) | _known(described_trial(bag) or _inside(bag)))
        for bag in bags
    ]


def _known(facts: dict[str, Any]) -> dict[str, Any]:
    """Return the facts that are not empty: `mixtac record` leaves them so where none was given."""
    return {name: value for name, value in facts.items() if value != ''}


def _inside(bag: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(custom_data(bag)['mixtac.trial']))
    except (ValueError, KeyError, TypeError):
        # Other bags have no such entry; a damaged bag is reported when it is loaded.
        return {}
