# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What real cameras recorded goes as words through a capture to our driver and comes out equal."""

from __future__ import annotations

import numpy as np
import pytest
from real_capture import real_capture, real_data, recordings

from mixtac_driver.camera import Davis346
from mixtac_driver.errors import EndOfStream
from mixtac_driver.playback.replay import ReplayBackend, ReplayedCamera
from mixtac_driver.usb.capture import CaptureWriter, read_capture
from mixtac_events.arrays import Events


@pytest.fixture(scope='module', params=['davis346_bag', 'davis346_sample.aedat4'])
def played(request, tmp_path_factory):
    """Return a recording, and what the driver made of it after it went through a capture file."""
    (path,) = recordings(request.param)
    capture = real_capture(path)
    file = tmp_path_factory.mktemp('real') / 'real.pcap'
    with file.open('wb') as out:
        writer = CaptureWriter(out)
        for made in capture.requests:
            writer.request(made)
        for arrival in capture.arrivals:
            writer.arrival(arrival.data, arrival.time_ns)
    again = read_capture(file)
    np.testing.assert_array_equal(again.words, capture.words)
    events, frames, samples = [], [], []
    with Davis346(backend=ReplayBackend(ReplayedCamera(again))) as camera:
        camera.start()
        batches = camera.batches()
        while True:
            try:
                decoded = next(batches).decoded
            except EndOfStream:
                break
            events.append(decoded.events.copy())
            frames += decoded.frames
            samples.append(decoded.imu)
    return real_data(path), (Events.concatenate(events), frames, samples)


def test_the_events_are_those_of_the_recording(played):
    (events, *_), (seen, *_) = played
    assert len(seen) == len(events) > 6000
    for name in ('t', 'x', 'y', 'polarity'):
        np.testing.assert_array_equal(getattr(seen, name), getattr(events, name))


def test_the_frames_are_those_of_the_recording(played):
    (_, frames, _, origin), (_, seen, _) = played
    if not frames:
        pytest.skip('the recording has no frames')
    for real, frame in zip(frames, seen, strict=True):
        np.testing.assert_array_equal(frame.image, real.image)
        assert frame.exposure_start_us == real.exposure_start_us - origin


def test_the_inertial_samples_are_those_of_the_recording(played):
    (_, _, samples, origin), (_, _, seen) = played
    if not samples:
        pytest.skip('the recording has no inertial samples')
    t = np.concatenate([each.t for each in seen])
    acceleration = np.concatenate([each.acceleration for each in seen])
    np.testing.assert_array_equal(t, [int(each[0]) - origin for each in samples])
    expected = np.array([each[1] for each in samples]) * 9.80665
    # Half a step of 16 bits at 4 g.
    np.testing.assert_allclose(acceleration, expected, atol=4 / 65536 * 9.81)
