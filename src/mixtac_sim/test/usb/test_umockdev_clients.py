# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Two drivers read the same virtual camera and see what was put in.

libcaer is independent of Mixtac; the other is ours. Each
runs unmodified in a process of its own. Its libusb talks to umockdev, a bridge forwards to the
virtual camera's socket. The clients run in the interpreter that ``MIXTAC_CLIENT_PYTHON`` names,
else in the running one if it has them.

All are shown the same mixed scene and then the same stream words that are hard to decode. Where
a client departs from the protocol there, the test states exactly how.
"""

from __future__ import annotations

import numpy as np
import pytest
from umockdev_scene import FULL, IMU_RAW, REGION, times_of
from umockdev_session import CLIENTS, need_umockdev, run_client

pytestmark = pytest.mark.umockdev

GRAVITY, DEGREE = 9.80665, np.pi / 180
RESET_EDGE = 1
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


def image(client, reset, signal):
    """Return the picture that a client makes of samples, by its own rule."""
    return subtracted(reset, signal) << (0 if client == 'ours' else 6)


def units(client):
    """Return a client's units of acceleration [g] and turn rate [deg/s]."""
    return (GRAVITY, DEGREE) if client == 'ours' else (1.0, 1.0)


def check_frame(result, number, frame, corner=(0, 0)):
    """Compare a frame with what was sent, as far as the client reports it."""
    expected = image(result.client, frame.reset, frame.signal)
    np.testing.assert_array_equal(result.frames[number], expected)
    assert tuple(result.seen['corners'][number]) == corner
    assert result.seen['frame_times'][number].tolist() == list(times_of(frame))


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
    assert result.seen['edges'][: len(expected)].tolist() == [list(edge) for edge in expected]


# The hard words.


def test_wrap_counts_and_resets_move_the_time_of_events(result):
    seen = result.seen['events'][len(result.scene.events) :].tolist()
    assert seen == [list(event) for event in result.hard.events]


def test_frame_of_a_region(result):
    check_frame(result, SCENE_FRAMES, result.hard.marks['region'], REGION[:2])


def test_frame_of_a_rolling_shutter(result):
    check_frame(result, SCENE_FRAMES + 1, result.hard.marks['rolling'], FULL[:2])


def test_incomplete_frames_are_dropped(result):
    assert len(result.frames[SCENE_FRAMES + 2 :]) == 1


def test_frame_after_a_reset(result):
    frame = result.hard.marks['whole']
    check_frame(result, len(result.frames) - 1, frame)


def test_inertial_sample_cut_by_a_reset(result):
    seen = result.seen['imu'][len(result.scene.readings) :]
    assert len(seen) == 1
    np.testing.assert_allclose(seen[0, 1:], imu_row(result.client, IMU_RAW), rtol=1e-5, atol=1e-6)
    assert seen[0, 0] == result.hard.marks['imu']


def imu_row(client, raw):
    gravity, degree = units(client)
    acceleration = [value * 4 / 32768 * gravity for value in raw[:3]]
    rate = [value * 500 / 32768 * degree for value in raw[4:]]
    return [*acceleration, *rate, raw[3] / 333.87 + 21]


def test_edges_around_a_reset(result):
    seen = result.seen['edges'].tolist()
    assert seen[-1] == [result.hard.marks['rising'], 3]
    assert sum(code == RESET_EDGE for _, code in seen) == 1


# What the clients wrote.


UNLIKE_LIBCAER = {(2, 12): 211_680, (9, 1): 16_128}
"""Our defaults are 7 ms of exposure and a shorter delay of early packets."""


def test_registers_are_those_that_libcaer_writes(sessions):
    """All writable ones, biases included; that is what makes a camera see alike."""
    reference, written = sessions('libcaer').registers, sessions('ours').registers
    unlike = {place: value for place, value in written.items() if value != reference[place]}
    assert unlike == UNLIKE_LIBCAER
    assert len(written) > 100
