# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Writing, reading and summarising bags."""

from __future__ import annotations

from pathlib import Path

import pytest
from recording_samples import START_US, Bag, some_events

from mixtac_core.events.packets import CodecError
from mixtac_core.node.topics import FORCE, TOPICS, WrenchWriter, message_class
from mixtac_core.recordings.bag import (
    BagFile,
    blank_message,
    custom_data,
    distinct_names,
    find_bags,
    fit_path,
    typestore,
)
from mixtac_core.recordings.bag_writer import BagWriter, McapBag, repair
from mixtac_core.recordings.importing import StreamWriter, import_recording
from mixtac_core.recordings.recording import DamagedRecordingError, RecordingError
from mixtac_core.recordings.summary import summarise

EVENTS = some_events(count=280, length_us=40_000)
STAMPS_NS = [5 * 10**9 + i * 2_000_000 for i in range(10)]
topics_to_compare = sorted({topic.type_name for topic in TOPICS})


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Return a bag of event packets and 10 wrenches, written from a thread."""
    writer = BagWriter(tmp_path / 'bag')
    stream = StreamWriter(writer, (346, 260))
    for index, stamp_ns in enumerate(STAMPS_NS):
        force = (0.0, 0.0, 0.1 * index, 0.0, 0.0, 0.0)
        stream.put(FORCE, 10**9 + index, WrenchWriter('ft').serialised(stamp_ns, force))
    stream.events(EVENTS, START_US + 41_000, 2 * 10**9)
    writer.close()
    assert writer.dropped == 0
    return tmp_path / 'bag'


def test_what_was_written_is_read(bag: Path):
    with BagFile(bag) as opened:
        assert opened.counts['/mixtac/force'] == 10
        stamps, forces = opened.wrenches('/mixtac/force')
        with pytest.raises(RecordingError):
            opened.wrenches('/mixtac/forces')
    assert stamps.tolist() == STAMPS_NS
    assert forces[:, 2] == pytest.approx([0.1 * i for i in range(10)])
    assert not forces[:, :2].any()
    events = summarise(bag).events['/mixtac/events']
    assert (events.events, events.lost.packets_missing, events.backward_steps) == (280, 0, 0)


@pytest.mark.parametrize('name', ['folder', 'table.csv', 'empty', 'nowhere'])
def test_what_is_no_bag_is_not_called_a_damaged_one(tmp_path: Path, name: str):
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'table.csv').write_text('1,2\n')
    (tmp_path / 'empty').touch()
    with pytest.raises(RecordingError) as caught:
        BagFile(tmp_path / name)
    assert not isinstance(caught.value, DamagedRecordingError)


def test_a_file_that_is_missing_of_a_bag_is_named(bag: Path):
    path = bag / 'metadata.yaml'
    path.write_text(path.read_text().replace('  - bag.mcap', '  - bag.mcap\n  - bag_1.mcap'))
    assert 'bag_1.mcap' in summarise(bag).damage


def test_packets_that_cannot_be_decoded_leave_the_other_topics(bag: Path, monkeypatch):
    def refuse(*_: object) -> None:
        raise CodecError('libcaer_cmp is damaged')

    monkeypatch.setattr('mixtac_core.events.codec.decode_message', refuse)
    found = summarise(bag)
    assert found.events == {}
    assert found.counts['/mixtac/force'] == 10
    assert '/mixtac/events' in found.damage
    assert 'libcaer_cmp' in found.damage


@pytest.mark.parametrize('name', topics_to_compare)
def test_blank_messages_are_those_of_ros(name: str):
    rclpy = pytest.importorskip('rclpy.serialization', reason='needs ROS 2')
    message = blank_message(name)
    if name.endswith('/Imu'):
        message.orientation.w = 1.0
    data = bytes(typestore().serialize_cdr(message, name))
    assert rclpy.deserialize_message(data, message_class(name)) == message_class(name)()


@pytest.mark.parametrize('backwards', [False, True])
def test_a_clock_that_was_reset_shows_in_the_summary(tmp_path: Path, backwards):
    with Bag(tmp_path / 'bag') as made:
        for at_us, start_us in enumerate((START_US, START_US + (-5000 if backwards else 5000))):
            part = some_events(count=9, length_us=900, start_us=start_us)
            made.packet(part, start_us + 900, stamp_us=START_US + at_us)
    summary = summarise(tmp_path / 'bag')
    assert summary.events['/mixtac/events'].backward_steps == backwards
    assert len(summary.warnings) == backwards


def test_what_the_writer_of_a_bag_said_of_it_survives_a_repair(bag: Path, tmp_path: Path):
    assert custom_data(bag) == custom_data(tmp_path / 'nowhere') == {}
    said = {'mixtac.simulated': 'true', 'mixtac.trial': '{"profile": "press"}'}
    with McapBag(tmp_path / 'said') as writer:
        writer.custom_data.update(said)
    repair(tmp_path / 'said', tmp_path / 'repaired')
    assert custom_data(tmp_path / 'repaired') == said


MAKERS = [BagWriter, lambda out: repair(out.with_name('bag'), out)]


@pytest.mark.parametrize('make', [*MAKERS, lambda out: import_recording(out / 'any.csv', out)])
def test_neither_a_bag_nor_the_clock_fit_of_an_earlier_one_is_taken_over(bag: Path, make):
    new = bag.with_name('new')
    fit_path(new).write_text('{}')
    for out, existing in ((bag, bag), (new, fit_path(new))):
        with pytest.raises(RecordingError) as caught:
            make(out)
        assert str(existing) in str(caught.value)
    assert not new.exists()


def test_a_bag_found_from_within_has_its_name(bag: Path, monkeypatch: pytest.MonkeyPatch):
    for place, given in ((bag, '.'), (bag / 'below', '..')):
        place.mkdir(exist_ok=True)
        monkeypatch.chdir(place)
        assert find_bags(Path(given)) == [bag.resolve()]


def test_bags_are_named_after_their_folders_where_their_own_names_repeat():
    apart, alike = [Path('d/static/a'), Path('d/b')], [Path('d/static/a'), Path('d/dynamic/a')]
    assert list(distinct_names(apart).values()) == ['a', 'b']
    assert list(distinct_names(alike).values()) == ['static_a', 'dynamic_a']
