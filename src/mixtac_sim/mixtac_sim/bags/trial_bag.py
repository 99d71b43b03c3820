# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Simulated trials as rosbag2 bags: the topics of the live graph, and the truth.

A bag is written whole or not at all. The bags of a data set are written in parallel, and a run that
was interrupted resumes where it ended.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Final

import joblib
import numpy as np
from joblib.externals.loky.process_executor import TerminatedWorkerError

from mixtac_core.node import topics
from mixtac_core.node.topics import Topic
from mixtac_core.recordings.bag import blank_message
from mixtac_core.recordings.bag_writer import McapBag
from mixtac_core.recordings.dataset import FILE_NAME, DatasetDescription, TrialSpec
from mixtac_core.recordings.recording import RecordingError
from mixtac_sim.bags.camera import (
    NS,
    BagMessage,
    CameraMessages,
    MessageSink,
    StampedRows,
    TrialClocks,
)
from mixtac_sim.usb.endpoints import serial_number
from mixtac_sim.world.sensor import truth_wrench
from mixtac_sim.world.trial import Stretch, TrialStream

NAMESPACE: Final = 'mixtac'
BAG_TOPICS: Final = (
    *(
        topics.EVENTS,
        topics.IMAGE_RAW,
        topics.CAMERA_INFO,
        topics.IMAGE_EXPOSURE,
        topics.IMU,
        topics.TEMPERATURE,
        topics.CAMERA_CLOCK,
    ),
    *(topics.REFERENCE_WRENCH, topics.TRUTH_WRENCH, topics.TRUTH_CONTACT, topics.TRUTH_CLOCK_FIT),
)
"""Topics in the order in which they are announced in the bag."""
BATCH_NS: Final = 4_000_000
"""The virtual sensor publishes every 4 ms."""


class TruthMessages:
    """Makes the messages of truth and reference of a trial.

    Args:
        trial: The trial.
        clocks: Clocks of the trial.
        sink: Takes the messages.
    """

    def __init__(self, trial: TrialStream, clocks: TrialClocks, sink: MessageSink) -> None:
        self._trial, self._clocks, self._sink = trial, clocks, sink
        self._reference = _rows(topics.REFERENCE_WRENCH, topics.REFERENCE_FRAME, 6)
        self._wrenches = _rows(topics.TRUTH_WRENCH, topics.CONTACT_FRAME, 6)
        self._points = _rows(topics.TRUTH_CONTACT, topics.CONTACT_FRAME, 3)

    def begin(self) -> None:
        """Make the true relation of the clocks, which is published once."""
        clocks, reference = self._clocks, self._trial.reference
        message = blank_message(topics.TRUTH_CLOCK_FIT.type_name)
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(clocks.epoch_ns, NS)
        message.a, message.b = clocks.reference_rate(reference), reference.offset_s
        message.camera_epoch = message.reference_epoch = 1e-9 * clocks.epoch_ns
        message.method, message.message = 'simulation', 'true relation of the clocks'
        self._sink.put(clocks.epoch_ns, topics.TRUTH_CLOCK_FIT.name, message)

    def add(self, stretch: Stretch) -> None:
        """Make the messages of the next stretch."""
        received_ns = int(self._clocks.to_host_ns(np.array(stretch.end_us, np.int64)))
        self._add_truth(stretch)
        self._add_reference(stretch, received_ns)

    def _add_truth(self, stretch: Stretch) -> None:
        truth = stretch.sensor.truth
        stamps_ns = self._clocks.to_host_ns(truth['t_us'].astype(np.int64))
        received = (-(-stamps_ns // BATCH_NS) * BATCH_NS).tolist()
        point = np.zeros((len(truth), 3))
        right, down = self._trial.contact_mm
        point[:, 0], point[:, 1], point[:, 2] = 1e-3 * right, -1e-3 * down, 1e-3 * truth['depth_mm']
        put = self._sink.put_rows
        put(received, topics.TRUTH_WRENCH.name, self._wrenches.make(stamps_ns, truth_wrench(truth)))
        put(received, topics.TRUTH_CONTACT.name, self._points.make(stamps_ns, point))

    def _add_reference(self, stretch: Stretch, latest_ns: int) -> None:
        samples, sensor = stretch.reference, self._trial.reference
        true_ns = (samples.t_ns - 1e9 * sensor.offset_s) / (1.0 + 1e-6 * sensor.drift_ppm)
        taken_ns = self._clocks.epoch_ns + true_ns.astype(np.int64)
        received = np.minimum(-(-taken_ns // BATCH_NS) * BATCH_NS, latest_ns).tolist()
        data = self._reference.make(self._clocks.epoch_ns + samples.t_ns, samples.wrench)
        self._sink.put_rows(received, topics.REFERENCE, data)


def _rows(topic: Topic, frame: str, numbers: int) -> StampedRows:
    message = blank_message(topic.type_name)
    message.header.frame_id = frame
    return StampedRows(message, numbers)


UNFINISHED: Final = '.unfinished'
"""Folder of half-written bags beside the finished ones."""


def trial_messages(trial: TrialStream) -> Iterator[BagMessage]:
    """Simulate a trial and yield its messages in the order of their reception.

    Args:
        trial: A trial that has not begun.
    """
    spec, sink = trial.spec, MessageSink()
    clocks = TrialClocks(spec.trial_seed)
    camera = CameraMessages(clocks, sink, serial_number(spec.device_seed))
    truth = TruthMessages(trial, clocks, sink)
    truth.begin()
    for stretch in trial.stretches():
        camera.add(stretch)
        truth.add(stretch)
        yield from sink.take(clocks.epoch_ns + 1000 * stretch.end_us)
    yield from sink.take(1 << 63)


def is_finished(folder: Path, name: str) -> bool:
    """Return whether the bag of a trial has been written."""
    return (folder / name / 'metadata.yaml').is_file()


def write_trial(spec: TrialSpec, folder: Path, *, compress: bool = False) -> None:
    """Write the bag of a trial, unless it is there already.

    The bag is written to a temporary folder and moved when it is complete.

    Args:
        spec: The trial.
        folder: Folder of the data set.
        compress: Compress the chunks of the bag (zstd).

    Raises:
        SimulationError: The trial cannot be simulated.
        RecordingError: The bag cannot be written.
    """
    if is_finished(folder, spec.name):
        return
    partial = folder / UNFINISHED / spec.name
    trial = TrialStream(spec)
    try:
        shutil.rmtree(partial, ignore_errors=True)
        partial.parent.mkdir(parents=True, exist_ok=True)
        writer = McapBag(partial, compressed=compress)
        writer.set_custom_data('mixtac.simulated', 'true')
        writer.set_custom_data('mixtac.trial', json.dumps(asdict(spec)))
        with writer:
            connections = {
                each.name: writer.add_topic(
                    each.resolved(NAMESPACE), each.type_name, latched=each.latched
                )
                for each in BAG_TOPICS
            }
            for message in trial_messages(trial):
                writer.write(connections[message.topic], message.received_ns, message.data)
        partial.rename(folder / spec.name)
    except OSError as error:
        raise RecordingError(
            f'cannot write bag {folder / spec.name}: {error}',
            remedy='free some space, or choose another folder',
        ) from error


def generate(
    description: DatasetDescription,
    folder: Path,
    *,
    jobs: int = 1,
    compress: bool = False,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> int:
    """Write the bags of a data set that are not there yet, and its description.

    Args:
        description: The data set.
        folder: Its folder; new, empty, or that of an earlier run of the same data set.
        jobs: Processes.
        compress: Compress the bags (zstd).
        on_progress: Called with the number of finished trials and of all.

    Returns:
        Number of bags written by this run.

    Raises:
        RecordingError: The folder holds something else, or cannot be written.
        SimulationError: A trial cannot be simulated.
    """
    _claim(folder, description)
    waiting = [each for each in description.trials if not is_finished(folder, each.name)]
    total = len(description.trials)
    on_progress(total - len(waiting), total)
    if waiting:
        calls = [joblib.delayed(write_trial)(spec, folder, compress=compress) for spec in waiting]
        try:
            written = joblib.Parallel(n_jobs=jobs, return_as='generator_unordered', batch_size=1)(
                calls
            )
            for done, _ in enumerate(written, total - len(waiting) + 1):
                on_progress(done, total)
        except TerminatedWorkerError as error:
            raise RecordingError(
                'a worker process was killed, probably out of memory; finished bags are kept',
                remedy='use fewer jobs',
            ) from error
    shutil.rmtree(folder / UNFINISHED, ignore_errors=True)
    replace(description, complete=True).write(folder)

    return len(waiting)


def _claim(folder: Path, description: DatasetDescription) -> None:
    """Make a folder, check that it is empty or holds this very data set, and describe it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordingError(
            f'cannot use folder {folder}: {error}', remedy='choose another folder'
        ) from error
    if (folder / FILE_NAME).exists():
        if not DatasetDescription.read(folder).same_trials_as(description):
            raise RecordingError(
                f'{folder} holds a data set of other trials or of another simulator version',
                remedy='choose another folder',
            )
        return
    if any(folder.iterdir()):
        raise RecordingError(
            f'{folder} is not empty and holds no data set', remedy='choose another folder'
        )
    description.write(folder)
