# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Four drivers read the same virtual camera and see what was put in.

libcaer, neuromorphic-drivers and dv-processing know nothing of Mixtac; the fourth is ours. Each
runs unmodified in a process of its own. Its libusb talks to umockdev, a bridge forwards to the
virtual camera's socket. The clients run in the interpreter that ``MIXTAC_CLIENT_PYTHON`` names,
else in the running one if it has them.

All are shown the same mixed scene and then the same stream words that are hard to decode. Where
a client departs from the protocol there, the test states exactly how.
"""

from __future__ import annotations

import struct

import numpy as np
import pytest
from umockdev_scene import (
    CUT_COLUMNS,
    DURATION_US,
    FULL,
    IMU_RAW,
    IMU_REST,
    REGION,
    SIGNAL_COLUMNS,
    make_scene,
)
from umockdev_session import CLIENTS, need_umockdev, run_client

from mixtac_sim.usb.device import VirtualDavis346

pytestmark = pytest.mark.umockdev

GRAVITY, DEGREE = 9.80665, np.pi / 180
RESET_EDGE = 1
GENERATOR = (16, 17)
SCENE_FRAMES = 10


@pytest.fixture(scope='module')
def sessions(tmp_path_factory):
    """Return a function that runs a client, once, and returns what it saw and wrote."""
    need_umockdev()
    done = {}

    def session(client):
        if client not in done:
            done[client] = run_client(client, tmp_path_factory.mktemp(client))
        return done[client]

    return session


@pytest.fixture(scope='module', params=CLIENTS)
def result(request, sessions):
    """What one client saw of the one camera."""
    return sessions(request.param)


def subtracted(reset, signal):
    """The difference of both samples; too dark a reset sample means over-exposed."""
    over = (reset < 384) | (signal == 0)
    return np.where(over, 1023, np.clip(reset.astype(int) - signal, 0, 1023))


def subtracted_8_bit(reset, signal):
    """The same of the upper eight bits."""
    reset, signal = reset.astype(int) >> 2, signal.astype(int) >> 2
    return np.where((reset < 96) | (signal == 0), 255, np.maximum(reset - signal, 0))


def image(client, reset, signal):
    """Return the picture that a client makes of samples, by its own rule."""
    if client == 'dv':
        return subtracted_8_bit(reset, signal)
    return subtracted(reset, signal) << (0 if client == 'ours' else 6)


def units(client):
    """Return a client's units of acceleration [g] and turn rate [deg/s]."""
    return (GRAVITY, DEGREE) if client in {'ours', 'neuromorphic'} else (1.0, 1.0)


def check_frame(result, number, frame, corner=(0, 0), late_us=0):
    """Compare a frame with what was sent, as far as the client tells."""
    expected = image(result.client, frame.reset, frame.signal)
    np.testing.assert_array_equal(result.frames[number], expected)
    assert tuple(result.seen['corners'][number]) == corner
    times = [t + late_us for t in frame.times]
    if result.client == 'dv':
        # It takes the exposure from the register words, which say 4 us in the frames by hand.
        exposure_us = 4 if number >= SCENE_FRAMES else times[2] - times[1]
        times = [-1, times[1], times[1] + exposure_us, -1]
    assert result.seen['frame_times'][number].tolist() == times


# The mixed scene.


def test_events_are_those_of_the_scene(result):
    e = result.scene.events
    expected = np.stack([e.t, e.x, e.y, e.polarity], axis=1).astype(np.int64)
    np.testing.assert_array_equal(result.seen['events'][: len(expected)], expected)
    assert result.losses['events_dropped'] == 0


def test_frames_are_those_of_the_scene(result):
    assert len(result.scene.frames) == SCENE_FRAMES
    for number, frame in enumerate(result.scene.frames):
        check_frame(result, number, frame)
    assert result.losses['frames_dropped'] == 0


def test_inertial_samples_are_those_of_the_scene(result):
    readings = result.scene.readings
    seen = result.seen['imu'][: len(readings)]
    gravity, degree = units(result.client)
    np.testing.assert_array_equal(seen[:, 0], [r.t_us for r in readings])
    acceleration = np.array([r.acceleration_g for r in readings]) * gravity
    rate = np.array([r.rate_dps for r in readings]) * degree
    # Half a step of 16 bits at 4 g and 500 deg/s, which all of them set.
    half_steps = 4 / 65536 * gravity, 500 / 65536 * degree
    np.testing.assert_allclose(seen[:, 1:4], acceleration, rtol=1e-6, atol=half_steps[0])
    np.testing.assert_allclose(seen[:, 4:7], rate, rtol=1e-6, atol=half_steps[1])
    np.testing.assert_allclose(seen[:, 7], [r.temperature_c for r in readings], atol=0.002)


def test_edges_are_those_of_the_scene(result):
    expected = result.scene.edges
    if result.client == 'neuromorphic':
        # It has no edges of the generator.
        expected = [(t, code) for t, code in expected if code not in GENERATOR]
    assert result.seen['edges'][: len(expected)].tolist() == [list(edge) for edge in expected]


# The hard words.


def test_wrap_counts_and_resets_move_the_time_of_events(result):
    hard = result.hard
    seen = result.seen['events'][len(result.scene.events) :].tolist()
    expected = [list(event) for event in hard.events]
    before = [event[0] > 1_000_000 for event in expected].count(True)
    if result.client == 'dv':
        for event in expected[before:]:
            event[0] += int(result.seen['restart_us'])
        # At a reset it forgets events that it has not handed on yet, up to 10 ms of them.
        seen_before = len(seen) - len(expected) + before
        assert before - 1 <= seen_before
        expected[seen_before:before] = []
    if result.client == 'neuromorphic':
        # It counts every wrap word as one wrap, and its clock knows no reset and never goes back.
        for event, late in zip(expected[:before], hard.lateness[:before], strict=True):
            event[0] -= late
        for event in expected[before:]:
            event[0] = neuromorphic_time_after_reset(result)
    assert seen == expected


def neuromorphic_time_after_reset(result):
    """Return where its clock stands: at the last stamp before the reset, every wrap being one."""
    hard = result.hard
    return hard.marks['last_before_reset'] - hard.late


def test_frame_of_a_region(result):
    frame = result.hard.marks['region']
    if result.client != 'neuromorphic':
        check_frame(result, SCENE_FRAMES, frame, REGION[:2])
        return
    # It takes every frame for a whole one and fills it from the upper left corner.
    expected = np.zeros((260, 346), int)
    expected[:60, :100] = image(result.client, frame.reset, frame.signal)
    np.testing.assert_array_equal(result.frames[SCENE_FRAMES], expected)


def test_frame_of_a_rolling_shutter(result):
    check_frame(result, SCENE_FRAMES + 1, result.hard.marks['rolling'], FULL[:2])


def test_incomplete_frames_are_dropped(result):
    frames = result.frames[SCENE_FRAMES + 2 :]
    if result.client != 'neuromorphic':
        assert len(frames) == 1
        return
    # It hands both on; the bare reset sample stands where the signal is missing.
    incomplete, cut, _ = frames
    frame = result.hard.marks['incomplete']
    expected = frame.reset.astype(int)
    expected[:SIGNAL_COLUMNS] = image(
        result.client, frame.reset[:SIGNAL_COLUMNS], frame.signal[:SIGNAL_COLUMNS]
    )
    np.testing.assert_array_equal(incomplete, expected)
    expected = result.hard.marks['cut'].astype(int)
    expected[CUT_COLUMNS:] = 0
    np.testing.assert_array_equal(cut, expected)


def test_frame_after_a_reset(result):
    frame = result.hard.marks['whole']
    if result.client == 'neuromorphic':
        expected = image(result.client, frame.reset, frame.signal)
        np.testing.assert_array_equal(result.frames[-1], expected)
        return
    check_frame(result, len(result.frames) - 1, frame, late_us=int(result.seen['restart_us']))


def test_inertial_sample_cut_by_a_reset(result):
    seen = result.seen['imu'][len(result.scene.readings) :]
    expected = [imu_row(result.client, IMU_RAW)]
    if result.client in {'neuromorphic', 'dv'}:
        # They put the bytes before and after the reset together.
        data = struct.pack('>7h', *IMU_RAW)[:7] + bytes(IMU_REST)
        expected.insert(0, imu_row(result.client, struct.unpack('>7h', data)))
    assert len(seen) == len(expected)
    np.testing.assert_allclose(seen[:, 1:], expected, rtol=1e-5, atol=1e-6)
    if result.client != 'neuromorphic':
        assert seen[-1, 0] == result.hard.marks['imu'] + int(result.seen['restart_us'])


def imu_row(client, raw):
    gravity, degree = units(client)
    acceleration = [value * 4 / 32768 * gravity for value in raw[:3]]
    rate = [value * 500 / 32768 * degree for value in raw[4:]]
    return [*acceleration, *rate, raw[3] / 333.87 + 21]


def test_edges_around_a_reset(result):
    seen = result.seen['edges'].tolist()
    rising = [result.hard.marks['rising'] + int(result.seen['restart_us']), 3]
    if result.client == 'neuromorphic':
        rising[0] = neuromorphic_time_after_reset(result)
    assert seen[-1] == rising
    # Only these two report the reset.
    resets = sum(code == RESET_EDGE for _, code in seen)
    assert resets == (result.client in {'ours', 'libcaer'})


# What the clients wrote.


REGISTERS_UNLIKE_LIBCAER = {
    # Our defaults are 7 ms of exposure and a shorter delay of early packets.
    'ours': {(2, 12): 211_680, (9, 1): 16_128},
    # It leaves the edge detector off and lets the generator's pulses touch: 5 us every 5 us.
    'neuromorphic': {(4, k): 0 for k in range(4)} | {(4, 13): 605, (4, 14): 605},
    # It wants no edges, frames as often as can be, and three biases switched off.
    'dv': {
        **{(4, k): 0 for k in range(1, 6)},
        (4, 13): 1210,
        (4, 14): 605,
        (2, 13): 0,
        (5, 9): 14,
        (5, 26): 14,
        (5, 27): 14,
    },
}


@pytest.mark.parametrize('client', [each for each in CLIENTS if each != 'libcaer'])
def test_registers_are_those_that_libcaer_writes(sessions, client):
    """All writable ones, biases included; that is what makes a camera see alike."""
    reference, written = sessions('libcaer').registers, sessions(client).registers
    unlike = {place: value for place, value in written.items() if value != reference[place]}
    assert unlike == REGISTERS_UNLIKE_LIBCAER[client]
    assert len(written) > 100


# Without a client.


def test_our_decoder_and_the_scene_agree():
    """The same scene through our own decoder, without USB."""
    from mixtac_driver.davis346.model import Geometry
    from mixtac_driver.decode.decoder import StreamDecoder

    scene = make_scene()
    device = VirtualDavis346('V0000346', clock=lambda: 0)
    for module, param in ((0, 3), (9, 0), (0, 1), (0, 0), (1, 3), (2, 4), (3, 2), (3, 3), (3, 4)):
        device.control(0x40, 0xBF, module, param, struct.pack('>I', 1))
    device.submit(scene.events, scene.frames, scene.readings)
    decoder = StreamDecoder(Geometry())
    events, frames, samples = [], [], []
    for t in range(0, DURATION_US + 50_000, 1000):
        device.advance(t)
        if not len(device._fifo):
            continue
        for batch in decoder.push(device.read_bulk(0x82, 1 << 20, 1.0)):
            e = batch.events
            events.append(np.stack([e.t, e.x, e.y, e.polarity], axis=1).astype(np.int64))
            frames += batch.frames
            samples += batch.imu.t.tolist()
    e = scene.events
    expected = np.stack([e.t, e.x, e.y, e.polarity], axis=1).astype(np.int64)
    np.testing.assert_array_equal(np.concatenate(events), expected)
    for seen, frame in zip(frames, scene.frames, strict=True):
        np.testing.assert_array_equal(seen.image, image('ours', frame.reset, frame.signal))
    assert samples == [r.t_us for r in scene.readings]
