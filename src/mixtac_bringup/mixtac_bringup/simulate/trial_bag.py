# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""One simulated trial to one rosbag2 bag, whole or not at all."""

from __future__ import annotations

import json
import shutil
from typing import TYPE_CHECKING, Final

from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from mixtac_bringup.bag_types import typestore
from mixtac_bringup.bag_writer import offered_qos
from mixtac_bringup.errors import BagError
from mixtac_bringup.simulate.bag_topics import BAG_TOPICS, NAMESPACE, frame_ids
from mixtac_bringup.simulate.camera_messages import CameraMessages
from mixtac_bringup.simulate.message_factory import MessageFactory
from mixtac_bringup.simulate.message_sink import MessageSink
from mixtac_bringup.simulate.trial_clocks import TrialClocks
from mixtac_bringup.simulate.truth_messages import TruthMessages
from mixtac_sim.datasets.trial_stream import TrialStream
from mixtac_sim.usb.descriptors import serial_number

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from mixtac_bringup.simulate.message_sink import BagMessage
    from mixtac_sim.datasets.trial_spec import TrialSpec

UNFINISHED: Final = '.unfinished'
"""Folder of half-written bags beside the finished ones."""


def trial_messages(trial: TrialStream) -> Iterator[BagMessage]:
    """Simulate a trial and yield its messages in the order of their reception.

    Args:
        trial: A trial that has not begun.
    """
    spec, sink = trial.spec, MessageSink()
    clocks = TrialClocks(spec.trial_seed)
    factory = MessageFactory(typestore(), frame_ids(), serial_number(spec.device_seed))
    camera = CameraMessages(clocks, factory, sink)
    truth = TruthMessages(trial, clocks, factory, sink)
    truth.begin()
    for stretch in trial.stretches():
        camera.add(stretch)
        truth.add(stretch)
        yield from sink.take(clocks.epoch_ns + 1000 * stretch.end_us)
    yield from sink.take(1 << 63)


def is_finished(folder: Path, name: str) -> bool:
    """Return whether the bag of a trial has been written."""
    return (folder / name / 'metadata.yaml').is_file()


def write_trial(spec: TrialSpec, folder: Path, *, compress: bool = False) -> int:
    """Write the bag of a trial, unless it is there already.

    The bag grows in a folder of its own and is moved to its place when it is complete.

    Args:
        spec: The trial.
        folder: Folder of the data set.
        compress: Compress the chunks of the bag (zstd).

    Returns:
        Number of messages written; 0 where the bag was there.

    Raises:
        SimulationError: The trial cannot be simulated.
        BagError: The bag cannot be written.
    """
    if is_finished(folder, spec.name):
        return 0
    partial = folder / UNFINISHED / spec.name
    try:
        shutil.rmtree(partial, ignore_errors=True)
        partial.parent.mkdir(parents=True, exist_ok=True)
        count = _write(spec, partial, compress=compress)
        partial.rename(folder / spec.name)
    except OSError as error:
        raise BagError(
            f'bag {folder / spec.name} cannot be written ({error}): free some space or choose '
            'another folder'
        ) from error
    return count


def _write(spec: TrialSpec, path: Path, *, compress: bool) -> int:
    trial = TrialStream(spec)
    store, count = typestore(), 0
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    if compress:
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    writer.set_custom_data('mixtac.simulated', 'true')
    writer.set_custom_data('mixtac.trial', json.dumps(spec.to_dict()))
    with writer:
        connections = {
            each.name: writer.add_connection(
                each.resolved(NAMESPACE),
                each.type_name,
                typestore=store,
                offered_qos_profiles=(offered_qos(reliable=each.reliable, latched=each.latched),),
            )
            for each in BAG_TOPICS
        }
        for message in trial_messages(trial):
            writer.write(connections[message.topic], message.received_ns, message.data)
            count += 1
    return count
