# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Captures: written at the seam, read back, and replayed by a camera that is not there."""

from __future__ import annotations

import contextlib
import io
import struct
import time
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from virtual_scene import Scene

from mixtac_driver.camera import Davis346
from mixtac_driver.doctor.stream import measure
from mixtac_driver.errors import EndOfStream
from mixtac_driver.parameters import DriverParameters
from mixtac_driver.playback.replay import ReplayBackend, ReplayedCamera
from mixtac_driver.source import SourceKind, make_source, source_kind
from mixtac_driver.usb.capture import (
    DEVICE,
    GET_DESCRIPTOR,
    HEADER,
    MEMBER,
    PACKET,
    SERIAL,
    CaptureWriter,
    Request,
    read_capture,
)
from mixtac_events.arrays import Events
from mixtac_recordings.recording import RecordingError
from mixtac_sim.usb.pyusb_backend import in_process_backend

SHIPPED = Path(__file__).parent / 'virtual.zip'
"""Half a second of the virtual camera with small frames, written by `mixtac capture`."""


class Seen:
    """What a source delivered."""

    def __init__(self):
        self.events, self.frames, self.samples = [], [], 0

    def add(self, batch):
        e = batch.decoded.events
        self.events.append(Events(*(np.array(c) for c in (e.t, e.x, e.y, e.polarity))))
        self.frames += batch.decoded.frames
        self.samples += len(batch.decoded.imu.t)

    @property
    def all(self):
        return Events.concatenate(self.events)


def same(a, b):
    return all(
        np.array_equal(getattr(a, name), getattr(b, name)) for name in ('t', 'x', 'y', 'polarity')
    )


def collect(source, seen):
    """Take everything up to the end of the recording."""
    ended = False
    try:
        for batch in source.batches():
            seen.add(batch)
    except EndOfStream:
        ended = True
    assert ended


def play(capture):
    """Return what the driver delivers of a capture, by its own source."""
    seen = Seen()
    with Davis346(backend=ReplayBackend(ReplayedCamera(capture))) as camera:
        identity = camera.identity
        camera.start()
        collect(camera, seen)
    return identity, seen


@pytest.fixture(scope='module')
def captured(tmp_path_factory):
    """Return a capture of a virtual camera, its file, and what was seen while it was made."""
    path = tmp_path_factory.mktemp('capture') / 'camera.pcap'
    scene, seen = Scene(), Seen()
    with path.open('wb') as out:
        writer = CaptureWriter(out, rename=lambda serial: 'h' + serial[1:])
        backend = in_process_backend(scene.device)
        with Davis346(backend=backend, capture=writer) as camera:
            camera.start()
            until = time.monotonic() + 0.6
            for batch in camera.batches():
                seen.add(batch)
                # A starved host takes longer to send as much.
                events = sum(len(each) for each in seen.events)
                enough = events > 5000 and len(seen.frames) > 5 and seen.samples > 50
                if enough and time.monotonic() > until:
                    break
    scene.close()
    return read_capture(path), path, seen, writer


def test_a_capture_holds_requests_and_data(captured):
    capture, _, _, writer = captured
    assert len(capture.requests) == writer.counts['requests']
    assert sum(len(a.data) for a in capture.arrivals) == writer.counts['bytes']
    assert capture.registers()[6, 0] == 18
    assert capture.missing == 0
    serial = capture.descriptors()[SERIAL]
    assert serial[2:].decode('utf-16-le') == 'h0000042'


def test_the_replay_has_the_same_events_frames_and_samples(captured):
    capture, _, seen, _ = captured
    identity, replayed = play(capture)
    assert identity.serial == 'h0000042'
    assert same(replayed.all, seen.all)
    assert len(seen.all) > 5000
    assert len(replayed.frames) == len(seen.frames) > 5
    for a, b in zip(replayed.frames, seen.frames, strict=True):
        np.testing.assert_array_equal(a.image, b.image)
        assert a.exposure_start_us == b.exposure_start_us
    assert replayed.samples == seen.samples > 50


def test_the_words_come_in_the_same_transfers_and_not_early(captured):
    capture = captured[0]
    camera = ReplayedCamera(capture)
    began_ns, got, came_ns, buffer = time.monotonic_ns(), [], [], bytearray(1 << 16)
    for module, parameter in ((9, 0), (0, 1), (0, 0)):
        camera.control(0x40, 0xBF, module, parameter, struct.pack('>I', 1))
    camera.control(0x40, 0xC2, 2, 0, struct.pack('>BBIBBI', 0, 2, 1, 0, 2, 0))
    with contextlib.suppress(EndOfStream):
        while True:
            # A host that was starved has captured long pauses.
            got.append(bytes(buffer[: camera.read(0x82, buffer, 60.0)]))
            came_ns.append(time.monotonic_ns() - began_ns)
    assert b''.join(got) == capture.words.tobytes()
    # The transfer with the reset is cut there.
    assert len(capture.arrivals) <= len(got) <= len(capture.arrivals) + 1
    sizes, stamps_ns = zip(*((len(a.data), a.time_ns) for a in capture.arrivals), strict=True)
    reset = 2 * np.flatnonzero(capture.words == 1)[0]
    late_ns = np.array(stamps_ns)[np.searchsorted(np.cumsum(sizes), reset, 'right') :]
    late_ns -= late_ns[0]
    assert len(late_ns) > 1
    assert np.all(came_ns[-len(late_ns) :] >= late_ns)


def test_a_bundle_is_a_recording_of_the_driver(captured, tmp_path):
    _, path, seen, _ = captured
    bundle = tmp_path / 'bundle.zip'
    with zipfile.ZipFile(bundle, 'w', zipfile.ZIP_DEFLATED) as archive:
        archive.write(path, 'capture.pcap')
    assert source_kind(str(bundle)) is SourceKind.RECORDED
    source = make_source(DriverParameters(device=str(bundle)))
    replayed = Seen()
    source.open()
    source.start()
    collect(source, replayed)
    source.close()
    assert same(replayed.all, seen.all)


def test_a_device_descriptor_of_which_the_host_had_the_beginning_is_completed():
    whole = read_capture(SHIPPED)
    asked = Request(0, *GET_DESCRIPTOR, DEVICE << 8, 0, bytes((18, 1, 0, 3, 0, 0, 0, 9)))
    others = [each for each in whole.requests if each.value != asked.value]
    short = replace(whole, requests=(asked, *others))
    with Davis346(backend=ReplayBackend(ReplayedCamera(short))) as camera:
        assert camera.identity.chip == 'DAVIS346B'


def test_a_loop_begins_again(captured):
    arrivals = captured[0].arrivals
    camera = ReplayedCamera(captured[0], loop=True)
    with Davis346(backend=ReplayBackend(camera)) as replayed:
        result = measure(replayed, 2e-9 * (arrivals[-1].time_ns - arrivals[0].time_ns) + 0.6)
    assert result.clock_resets >= 1


def test_the_shipped_capture_is_whole():
    capture = read_capture(SHIPPED)
    identity, seen = play(capture)
    assert SHIPPED.stat().st_size < 100_000
    assert (identity.chip, identity.logic) == ('DAVIS346B', (18, 1))
    assert len(seen.all) > 1000
    assert len(seen.frames) >= 5
    assert seen.samples > 100
    assert np.all(np.diff(seen.all.t) >= 0)


def packets(path):
    """Return the packets of a capture as [header fields, payload]."""
    data, at, found = path.read_bytes(), 24, []
    while at < len(data):
        size = PACKET.unpack_from(data, at)[2]
        found.append([data[at : at + 16], data[at + 16 : at + 16 + size]])
        at += 16 + size
    return found


def test_captures_of_another_program_show_the_whole_bus(captured, tmp_path):
    """Shorter headers, another device, and data that were cut."""
    capture, path, _, _ = captured
    out = io.BytesIO()
    out.write(struct.pack('<IHHiIII', 0xA1B2C3D4, 2, 4, 0, 0, 65535, 189))
    cut = 0
    for head, packet in packets(path):
        fields = list(HEADER.unpack_from(packet))
        payload = packet[64:]
        if fields[1:3] == [ord('C'), 3] and len(payload) > 100 and not cut:
            cut, payload = len(payload) - 100, payload[:100]
        for address in (1, 2):
            fields[4] = address
            part = HEADER.pack(*fields) + (payload if address == 1 else payload[:2])
            out.write(head[:8] + struct.pack('<II', len(part), len(part)) + part)
    other = tmp_path / 'bus.pcap'
    other.write_bytes(out.getvalue())
    read = read_capture(other)
    assert read.missing == cut > 0
    assert len(read.arrivals) == len(capture.arrivals)
    assert read.registers() == capture.registers()


def test_a_capture_that_was_cut_ends_at_its_last_packet(captured, tmp_path):
    capture, path, _, _ = captured
    cut = tmp_path / 'cut.pcap'
    cut.write_bytes(path.read_bytes()[:-5])
    # The last packets are those that stop the camera.
    assert len(read_capture(cut).requests) == len(capture.requests) - 1


@pytest.mark.parametrize(
    'content',
    [
        b'',
        b'\x0a\x0d\x0d\x0a' + bytes(60),
        struct.pack('<IHHiIII', 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1),
        struct.pack('<IHHiIII', 0xA1B2C3D4, 2, 4, 0, 0, 65535, 220),
    ],
)
def test_other_files_are_refused(content, tmp_path):
    path = tmp_path / 'other.pcap'
    path.write_bytes(content)
    with pytest.raises(RecordingError):
        read_capture(path)


@pytest.mark.parametrize('method', [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_a_bundle_that_cannot_be_unpacked_is_refused(method, tmp_path):
    path = tmp_path / 'bundle.zip'
    with zipfile.ZipFile(path, 'w', method) as archive:
        archive.writestr(MEMBER, bytes(1000))
    data = bytearray(path.read_bytes())
    if method == zipfile.ZIP_DEFLATED:
        at = data.index(MEMBER.encode()) + len(MEMBER)
        data[at : at + 8] = b'\xff' * 8
    else:
        # Marked as encrypted.
        data[6] = data[data.index(b'PK\x01\x02') + 8] = 1
    path.write_bytes(data)
    with pytest.raises(RecordingError):
        read_capture(path)


def test_a_capture_without_its_beginning_is_refused(captured, tmp_path):
    path = tmp_path / 'late.pcap'
    with path.open('wb') as out:
        CaptureWriter(out).arrival(b'\1\0', 0)
    with pytest.raises(RecordingError):
        ReplayedCamera(read_capture(path))
    with zipfile.ZipFile(tmp_path / 'empty.zip', 'w') as archive:
        archive.writestr('README.txt', '')
    with pytest.raises(RecordingError):
        read_capture(tmp_path / 'empty.zip')
    with pytest.raises(RecordingError):
        make_source(DriverParameters(device=str(tmp_path / 'none.pcap')))
