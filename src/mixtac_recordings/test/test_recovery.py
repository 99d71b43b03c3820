# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bags that were cut off or damaged: what is whole comes out, and what is missing is said."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import struct
import subprocess
import sys
import zlib

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode

from mixtac_recordings import recording
from mixtac_recordings.bag import BagFile, blank_message, find_bags, typestore
from mixtac_recordings.bag_writer import McapBag, repair
from mixtac_recordings.recording import DamagedRecordingError, RecordingError
from mixtac_recordings.summary import summarise

IMAGE, WRENCH = 'sensor_msgs/msg/Image', 'geometry_msgs/msg/WrenchStamped'
PAGE = 4096


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


def contents(path, **options):
    with BagFile(path, **options) as bag:
        found = list(bag.messages(*bag.types, raw=bag.types))
        assert sum(bag.counts.values()) == len(found)
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
    path = folder / 'bag.db3'
    data = path.read_bytes()
    # A row is whole when the pages with its first and its last bytes are.
    ends = [max(data.index(each[:60]), data.index(each[-60:])) for _, _, each in sent]
    return path, sent, [end // PAGE * PAGE + PAGE for end in ends]


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


@pytest.mark.parametrize('share', [0.0, *np.random.default_rng(1).random(15).tolist(), 0.999])
def test_a_cut_mcap_is_read_to_its_last_whole_chunk(mcap, tmp_path, share):
    path, sent = mcap
    data = path.read_bytes()
    kept = int(share * len(data))
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(data[:kept])
    count = sum(count for end, count in chunk_ends(data) if end <= kept)
    if not count:
        with pytest.raises(DamagedRecordingError):
            BagFile(cut)
        return
    found, damage = contents(cut)
    assert found == sent[:count]
    assert damage


@pytest.mark.parametrize('share', [0.0, *np.random.default_rng(2).random(15).tolist(), 0.999])
def test_a_cut_sqlite_is_read_to_its_last_whole_rows(sqlite, tmp_path, share):
    path, sent, ends = sqlite
    data = path.read_bytes()
    kept = int(share * len(data))
    cut = tmp_path / 'cut.db3'
    cut.write_bytes(data[:kept])
    whole = [message for message, end in zip(sent, ends, strict=True) if end <= kept]
    try:
        found, damage = contents(cut)
    except DamagedRecordingError:
        found, damage = [], 'nothing can be read'
    assert found == whole
    assert damage


def test_the_log_of_a_killed_recorder_is_read(sqlite, tmp_path):
    path, sent, _ = sqlite
    work, killed = tmp_path / 'work.db3', tmp_path / 'killed' / 'bag_0.db3'
    killed.parent.mkdir()
    shutil.copy(path, work)
    database = sqlite3.connect(work)
    database.execute('PRAGMA journal_mode=WAL')
    late = (10**18 + 500, sent[1][2])
    database.execute('INSERT INTO messages (topic_id, timestamp, data) VALUES (2, ?, ?)', late)
    database.commit()
    for suffix in ('', '-wal'):
        shutil.copy(f'{work}{suffix}', f'{killed}{suffix}')
    database.close()
    found, damage = contents(killed.parent)
    assert found == [*sent, ('/force', *late)]
    assert 'bag_0.db3' in damage
    repair(killed.parent, tmp_path / 'repaired')
    assert contents(tmp_path / 'repaired') == (found, '')


def test_a_damaged_chunk_costs_its_own_messages_only(mcap, tmp_path):
    path, sent = mcap
    data = bytearray(path.read_bytes())
    (first, lost), (second, after) = list(chunk_ends(bytes(data)))[:2]
    data[(first + second) // 2] ^= 1
    damaged = tmp_path / 'damaged.mcap'
    damaged.write_bytes(data)
    with pytest.raises(DamagedRecordingError):
        contents(damaged)
    result = repair(damaged, tmp_path / 'repaired')
    assert result.damage
    found, damage = contents(tmp_path / 'repaired')
    assert found == sent[:lost] + sent[lost + after :]
    assert not damage
    assert sum(result.counts.values()) == len(found)


@pytest.mark.parametrize('number', [0, 1, 2])
def test_a_chunk_that_lost_its_length_costs_its_own_messages_only(mcap, tmp_path, number):
    path, sent = mcap
    data = bytearray(path.read_bytes())
    chunks = list(chunk_ends(bytes(data)))
    # Topics are announced in the first chunk, and again at the end of the file.
    start = data.index(b'\x06', 8 if number == 0 else chunks[number - 1][0])
    start = next(at for at in range(start, len(data)) if is_chunk(data, at))
    data[start : start + 512] = bytes(512)
    damaged = tmp_path / 'damaged.mcap'
    damaged.write_bytes(data)
    result = repair(damaged, tmp_path / 'repaired')
    assert result.damage
    counts = [count for _, count in chunks]
    before, after = sum(counts[:number]), sum(counts[: number + 1])
    assert contents(tmp_path / 'repaired') == (sent[:before] + sent[after:], '')


def is_chunk(data, at):
    """Return whether the record of a chunk begins at a place."""
    code, length = struct.unpack_from('<BQ', data, at)
    return code == 6 and at + 9 + length in dict(chunk_ends(bytes(data)))


def test_messages_without_a_topic_are_said_to_be_missing(mcap, tmp_path):
    path, _ = mcap
    data = bytearray(path.read_bytes())
    ends = list(chunk_ends(bytes(data)))
    data[ends[0][0] // 2] ^= 1
    damaged = tmp_path / 'damaged.mcap'
    damaged.write_bytes(data[: ends[2][0]])
    with pytest.raises(DamagedRecordingError) as error:
        repair(damaged, tmp_path / 'repaired')
    assert str(ends[1][1] + ends[2][1]) in str(error.value)


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


@pytest.mark.parametrize('text', ['float64 ?', ''])
def test_a_repaired_bag_is_read_by_others_whatever_its_definitions_were(sqlite, tmp_path, text):
    change = f"UPDATE message_definitions SET encoded_message_definition = '{text}'"
    path = rewritten(sqlite, tmp_path, change)
    repair(path, tmp_path / 'repaired')
    with AnyReader([tmp_path / 'repaired']) as bag:
        found = [bag.deserialize(data, each.msgtype) for each, _, data in bag.messages()]
    assert len(found) == len(sqlite[1])


def test_a_repaired_bag_is_like_the_one_before_the_cut(mcap, tmp_path):
    path, sent = mcap
    cut = tmp_path / 'cut'
    cut.mkdir()
    (cut / 'cut.mcap').write_bytes(path.read_bytes()[:-200])
    assert find_bags(tmp_path) == [cut]
    assert find_bags(cut) == [cut]
    repair(cut, tmp_path / 'repaired')
    assert contents(tmp_path / 'repaired') == (sent, '')
    with BagFile(tmp_path / 'repaired') as bag, BagFile(path.parent) as before:
        assert bag.types == before.types
        assert [c.msgdef for c in bag.connections] == [c.msgdef for c in before.connections]
    with pytest.raises(RecordingError):
        repair(cut, tmp_path / 'repaired')


@pytest.mark.parametrize('unknown', ['schema', 'encoding', 'type'])
def test_a_topic_that_cannot_be_read_leaves_the_others(mcap, tmp_path, unknown):
    path, sent = mcap
    data = path.read_bytes()
    schema, name = (b'ros2msg', b'jsonsch') if unknown == 'schema' else (b'', b'')
    if unknown == 'encoding':
        schema, name = b'\x06\0\0\0/force\x03\0\0\0cdr', b'\x06\0\0\0/force\x03\0\0\0cbo'
    if unknown == 'type':
        schema, name = WRENCH.encode(), WRENCH.encode().replace(b'geometry', b'nowhere_')
    other = tmp_path / 'other.mcap'
    # The definitions are in the first chunk, whose checksum is then another.
    other.write_bytes(checked(data.replace(schema, name)))
    with BagFile(other) as bag:
        found = list(bag.messages('/image', raw=['/image']))
        assert found == [each for each in sent if each[0] == '/image']
        assert bag.counts['/force'] == len(sent) // 2
        assert ('/force' in bag.topics(WRENCH)) == (unknown == 'schema')
    result = repair(other, tmp_path / 'repaired')
    assert result.counts == {'/image': len(sent) // 2, '/force': len(sent) // 2}


def checked(data: bytes) -> bytes:
    """Return an MCAP file with the checksums of what its chunks hold."""
    out, at = bytearray(data), 8
    while at < len(data):
        code, length = struct.unpack_from('<BQ', data, at)
        if code == 6:
            struct.pack_into('<I', out, at + 9 + 24, zlib.crc32(data[at + 49 : at + 9 + length]))
        if code == 2:
            break
        at += 9 + length
    return bytes(out)


@pytest.mark.parametrize('mode', [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_compressed_bags_expand_within_bounds(tmp_path, monkeypatch, mode):
    with (writer := Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.SQLITE3)):
        pass
    folder = tmp_path / 'packed'
    writer = Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        sent = fill(writer, 3)
    assert contents(folder) == (sent, '')
    (folder / 'metadata.yaml').unlink()
    assert contents(folder)[0] == sent
    if mode is CompressionMode.FILE:
        usage = shutil.disk_usage(tmp_path)._replace(free=1000)
        monkeypatch.setattr('shutil.disk_usage', lambda _: usage)
    else:
        monkeypatch.setattr(recording, 'LARGEST_EXPANDED', 100)
    with pytest.raises(DamagedRecordingError):
        contents(folder)


def test_what_a_chunk_expands_to_is_bounded(tmp_path, monkeypatch):
    with McapBag(tmp_path / 'bag', compressed=True) as writer:
        sent = fill(writer, 3)
    assert contents(tmp_path / 'bag') == (sent, '')
    monkeypatch.setattr(recording, 'LARGEST_EXPANDED', 1000)
    with pytest.raises(DamagedRecordingError):
        contents(tmp_path / 'bag')
    with pytest.raises(DamagedRecordingError):
        contents(tmp_path / 'bag', whole=True)


def rewritten(sqlite, tmp_path, *statements):
    """Return a copy of an sqlite3 file after some statements."""
    path = tmp_path / 'bag.db3'
    shutil.copy(sqlite[0], path)
    with contextlib.closing(sqlite3.connect(path)) as database:
        for statement in statements:
            database.execute(statement)
        database.commit()
    return path


@pytest.mark.parametrize(
    'value',
    ["timestamp = 'never'", 'timestamp = -1', 'timestamp = 0.5', "data = 'text'", 'data = 1'],
)
def test_rows_that_are_no_messages_are_left_out_of_a_repair(sqlite, tmp_path, value):
    path = rewritten(sqlite, tmp_path, f'UPDATE messages SET {value} WHERE id = 5')
    found = repair(path, tmp_path / 'repaired')
    assert found.damage
    sent = [each for number, each in enumerate(sqlite[1], 1) if number != 5]
    assert contents(tmp_path / 'repaired')[0] == sent


def test_a_view_instead_of_messages_is_refused(sqlite, tmp_path):
    numbers = 'WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n LIMIT 1000)'
    rows = "SELECT x AS id, 1 AS topic_id, x AS timestamp, x'00' AS data FROM n"
    view = f'CREATE VIEW messages AS {numbers} {rows}'
    path = rewritten(sqlite, tmp_path, 'DROP TABLE messages', view)
    with pytest.raises(DamagedRecordingError):
        BagFile(path)


def test_topics_without_a_type_are_refused(sqlite, tmp_path):
    path = rewritten(sqlite, tmp_path, "UPDATE topics SET type = x'00'")
    with pytest.raises(DamagedRecordingError):
        repair(path, tmp_path / 'repaired')


@pytest.mark.parametrize('seed', range(20))
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
    for options in ({}, {'whole': True}):
        try:
            contents(damaged, **options)
        except RecordingError as error:
            assert str(damaged) in str(error)  # noqa: PT017  (it may be harmless)


FULL_DISK = """
import os, sys, time
from pathlib import Path
from mixtac_recordings import bag_writer
from mixtac_recordings.bag import BagFile
bag_writer.RESERVE = 1 << 20
path = Path(sys.argv[1]) / 'bag'
writer = bag_writer.BagWriter(path)
topic = writer.add_topic('/x', 'std_msgs/msg/String', latched=False)
number = 0
while not writer.failure:
    writer.write(topic, 10**18 + number, os.urandom(10_000))
    number += 1
    while number % 40 == 0 and writer.written['/x'] + writer.dropped < number:
        time.sleep(0.01)
writer.close()
with BagFile(path) as bag:
    found = [t for _, t, _ in bag.messages('/x', raw=['/x'])]
    assert found == [10**18 + n for n in range(len(found))]
    assert len(found) == writer.written['/x'] == number - writer.dropped
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
