# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bags that were cut off or damaged: what is whole is read, and what is missing is reported."""

from __future__ import annotations

import shutil
import sqlite3
import struct
import subprocess
import sys

import numpy as np
import pytest
from mcap.writer import IndexType
from mcap.writer import Writer as McapWriter
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode

from mixtac_core.recordings.bag import BagFile, blank_message, find_bags, typestore
from mixtac_core.recordings.bag_writer import McapBag, repair
from mixtac_core.recordings.recording import DamagedRecordingError, RecordingError
from mixtac_core.recordings.summary import summarise

IMAGE, WRENCH = 'sensor_msgs/msg/Image', 'geometry_msgs/msg/WrenchStamped'


def fill(writer, count=120):
    """Write messages of many sizes, none like another; return them."""
    types, rng, sent = typestore(), np.random.default_rng(0), []
    image, wrench = blank_message(IMAGE), blank_message(WRENCH)
    topics = [
        (writer.add_connection(name, kind, typestore=types), kind)
        for name, kind in (('/image', IMAGE), ('/force', WRENCH))
    ]
    for number in range(count):
        image.data = rng.integers(0, 256, rng.integers(1, 60_000)).astype(np.uint8)
        wrench.wrench.force.z, wrench.wrench.torque.z = rng.random(2)
        for (handle, kind), message in zip(topics, (image, wrench), strict=True):
            data = bytes(types.serialize_cdr(message, kind))
            writer.write(handle, 10**18 + number, data)
            sent.append((handle.topic, 10**18 + number, data))
    return sent


def contents(path):
    with BagFile(path) as bag:
        found = list(bag.messages(*bag.types, raw=bag.types))
        return found, bag.damage


@pytest.fixture(scope='module')
def mcap(tmp_path_factory):
    folder = tmp_path_factory.mktemp('mcap') / 'bag'
    with McapBag(folder) as writer:
        sent = fill(writer)
    return folder / 'bag.mcap', sent


@pytest.fixture(scope='module')
def sqlite(tmp_path_factory):
    folder = tmp_path_factory.mktemp('sqlite') / 'bag'
    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        sent = fill(writer)
    return folder / 'bag.db3', sent


def chunk_ends(data: bytes):
    """Yield where each chunk ends and how many messages it holds."""
    at = 8
    while at < len(data):
        code, length = struct.unpack_from('<BQ', data, at)
        if code == 6:
            inner, count, place = data[at + 9 + 40 : at + 9 + length], 0, 0
            while place < len(inner):
                kind, size = struct.unpack_from('<BQ', inner, place)
                count, place = count + (kind == 5), place + 9 + size
            yield at + 9 + length, count
        if code == 2:
            return
        at += 9 + length


@pytest.mark.parametrize('share', [0.0, *np.random.default_rng(1).random(9).tolist(), 0.999])
def test_a_cut_mcap_is_read_to_its_last_whole_chunk(mcap, tmp_path, share):
    path, sent = mcap
    data = path.read_bytes()
    kept = int(share * len(data))
    cut = tmp_path / 'cut'
    cut.mkdir()
    (cut / 'cut.mcap').write_bytes(data[:kept])
    assert find_bags(tmp_path) == find_bags(cut) == [cut]
    count = sum(count for end, count in chunk_ends(data) if end <= kept)
    if not count:
        with pytest.raises(DamagedRecordingError):
            BagFile(cut)
        return
    found, damage = contents(cut)
    assert found == sent[:count]
    assert damage
    repair(cut, tmp_path / 'repaired')
    assert contents(tmp_path / 'repaired') == (found, '')
    with BagFile(tmp_path / 'repaired') as bag, BagFile(path.parent) as before:
        assert bag.types == before.types
        assert [c.msgdef for c in bag.connections] == [c.msgdef for c in before.connections]


def test_a_damaged_chunk_costs_its_own_messages_only(mcap, tmp_path):
    path, sent = mcap
    data = bytearray(path.read_bytes())
    (first, lost), (second, after) = list(chunk_ends(bytes(data)))[:2]
    data[(first + second) // 2] ^= 1
    damaged = tmp_path / 'damaged.mcap'
    damaged.write_bytes(data)
    found, damage = contents(damaged)
    assert found == sent[:lost] + sent[lost + after :]
    assert damage
    assert summarise(damaged).damage
    counts, missing = repair(damaged, tmp_path / 'repaired')
    assert missing
    assert counts.total() == len(found)
    assert contents(tmp_path / 'repaired') == (found, '')


def test_zeros_in_a_chunk_without_a_checksum_are_noticed(tmp_path):
    with Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        sent = fill(writer, 20)
    path = tmp_path / 'bag' / 'bag.mcap'
    data = bytearray(path.read_bytes())
    assert not summarise(path.parent).damage
    place = data.index(sent[10][2])
    data[place - 31 : place + len(sent[10][2])] = bytes(31 + len(sent[10][2]))
    path.write_bytes(data)
    assert summarise(path.parent).damage


@pytest.mark.parametrize('repeated', [True, False])
def test_a_file_without_statistics_is_complete(tmp_path, repeated):
    path = tmp_path / 'x.mcap'
    with path.open('wb') as file:
        options = dict.fromkeys(
            ('repeat_channels', 'repeat_schemas', 'use_summary_offsets'), repeated
        )
        writer = McapWriter(file, use_statistics=False, index_types=IndexType.NONE, **options)
        writer.start('ros2')
        kind = writer.register_schema('std_msgs/msg/String', 'ros2msg', b'string data')
        topic = writer.register_channel('/x', 'cdr', kind)
        writer.add_message(topic, 5, b'\0\1\0\0\2\0\0\0a\0', 5)
        writer.finish()
    assert contents(path) == ([('/x', 5, b'\0\1\0\0\2\0\0\0a\0')], '')


def test_a_repaired_bag_is_read_by_others_without_definitions_of_its_own(sqlite, tmp_path):
    path = tmp_path / 'bag.db3'
    shutil.copy(sqlite[0], path)
    with sqlite3.connect(path) as database:
        database.execute("UPDATE message_definitions SET encoded_message_definition = ''")
    repair(path, tmp_path / 'repaired')
    with AnyReader([tmp_path / 'repaired']) as bag:
        found = [bag.deserialize(data, each.msgtype) for each, _, data in bag.messages()]
    assert len(found) == len(sqlite[1])


@pytest.mark.parametrize('share', [0.0, 0.3, 0.7, 0.999])
def test_a_cut_sqlite_file_is_refused_with_what_recovers_it(sqlite, tmp_path, share):
    cut = tmp_path / 'cut.db3'
    data = sqlite[0].read_bytes()
    cut.write_bytes(data[: int(share * len(data))])
    with pytest.raises(DamagedRecordingError) as error:
        contents(cut)
    assert 'sqlite3' in error.value.remedy
    assert '.recover' in error.value.remedy


def test_the_log_of_a_killed_recorder_is_not_overlooked(sqlite, tmp_path):
    path = tmp_path / 'bag_0.db3'
    shutil.copy(sqlite[0], path)
    path.with_name('bag_0.db3-wal').write_bytes(b'log')
    with pytest.raises(DamagedRecordingError) as error:
        BagFile(tmp_path)
    assert 'wal_checkpoint' in error.value.remedy


@pytest.mark.parametrize('mode', [CompressionMode.FILE, CompressionMode.MESSAGE])
@pytest.mark.parametrize('plugin', [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_compressed_bags_are_read(tmp_path, plugin, mode):
    writer = Writer(tmp_path / 'bag', version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        sent = fill(writer, 3)
    assert contents(tmp_path / 'bag') == (sent, '')
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    (path,) = (tmp_path / 'bag').iterdir()
    assert contents(tmp_path / 'bag') == contents(path) == (sent, '')


def test_the_files_of_a_split_bag_are_read_in_order_of_time(mcap, tmp_path):
    path, sent = mcap
    data = path.read_bytes()
    (first, count), *_ = chunk_ends(data)
    (tmp_path / 'b.mcap').write_bytes(data[:first])
    with McapBag(tmp_path / 'later') as writer:
        handle = writer.add_topic('/force', WRENCH, latched=False)
        writer.write(handle, 2 * 10**18, sent[1][2])
    shutil.copy(tmp_path / 'later' / 'later.mcap', tmp_path / 'a.mcap')
    shutil.rmtree(tmp_path / 'later')
    assert contents(tmp_path)[0] == [*sent[:count], ('/force', 2 * 10**18, sent[1][2])]


@pytest.mark.parametrize('seed', range(8))
def test_damage_anywhere_is_an_error_or_harmless(tmp_path, mcap, sqlite, seed):
    rng = np.random.default_rng(seed)
    path = (mcap, sqlite)[seed % 2][0]
    data = bytearray(path.read_bytes())
    # Half of the damage where the structure is: at both ends.
    at = int(rng.integers(len(data)) if seed % 4 < 2 else rng.integers(-10_000, 10_000))
    octets = rng.bytes(rng.integers(1, 8))
    data[at : at + len(octets)] = octets
    damaged = tmp_path / f'bag{path.suffix}'
    damaged.write_bytes(data)
    try:
        contents(damaged)
    except RecordingError as error:
        assert str(damaged) in str(error)  # noqa: PT017  (it may be harmless)


FULL_DISK = """
import os, sys, time
from pathlib import Path
from mixtac_core.recordings import bag_writer
from mixtac_core.recordings.bag import BagFile
bag_writer.RESERVE = 1 << 20
path = Path(sys.argv[1]) / 'bag'
writer = bag_writer.BagWriter(path)
topic = writer.add_topic('/x', 'std_msgs/msg/String', latched=False)
number = 0
while not writer.failure:
    writer.write(topic, 10**18 + number, os.urandom(10_000))
    number += 1
    if number % 40 == 0:
        time.sleep(0.05)
writer.close()
with BagFile(path) as bag:
    found = [t for _, t, _ in bag.messages('/x', raw=['/x'])]
    assert found == [10**18 + n for n in range(len(found))]
    assert len(found) == number - writer.dropped
    assert not bag.damage
print(len(found))
"""


def test_a_full_disk_ends_a_bag_that_is_complete(tmp_path):
    mount = f'mount -t tmpfs -o size=8m none {tmp_path} && exec "$@"'
    command = ['unshare', '-rm', 'sh', '-c', mount, 'sh']
    try:
        subprocess.run([*command, 'true'], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip('needs unprivileged mounts')
    run = [*command, sys.executable, '-c', FULL_DISK, str(tmp_path)]
    found = subprocess.run(run, check=True, capture_output=True, text=True)
    assert 400 < int(found.stdout) < 800
