# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The camera object on the virtual camera: what goes in comes out."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip('mixtac_sim.usb.device')

from virtual_scene import Scene

from mixtac_core.events.arrays import Events
from mixtac_core.events.readings import STANDARD_GRAVITY
from mixtac_driver.camera import Davis346
from mixtac_sim.usb.pyusb_backend import in_process_backend

pytestmark = pytest.mark.live


@pytest.fixture
def scene():
    scene = Scene()
    yield scene
    scene.close()


def camera_on(scene, parameters=None):
    return Davis346(parameters, backend=in_process_backend(scene.device))


def test_events_frames_and_samples_come_out_as_they_went_in(scene):
    with camera_on(scene) as camera:
        camera.start()
        parts, frames, imu, times = [], [], [], []
        for batch in camera.batches():
            parts.append(batch.decoded.events.copy())
            frames += batch.decoded.frames
            imu.append(batch.decoded.imu)
            times.append(batch.time_us)
            if sum(map(len, parts)) > 20_000 and len(frames) > 20:
                break
        counters, transport = camera.decoder_counters, camera.transport_counters
    got, given = Events.concatenate(parts), Events.concatenate(list(scene.given))
    assert len(got) > 10_000
    # The reset of the camera's clock leaves one unknown: where in the scene it happened.
    first = next(
        k
        for k in range(len(given) - 20)
        if (given.x[k : k + 20] == got.x[:20]).all() and (given.y[k : k + 20] == got.y[:20]).all()
    )
    # A camera that is read too late drops events; the others are those that went in.
    rows = [
        np.stack([each.t - t0, each.x, each.y, each.polarity], axis=1)
        for each, t0 in ((got, got.t[0]), (given, given.t[first]))
    ]
    assert set(map(tuple, rows[0].tolist())) <= set(map(tuple, rows[1].tolist()))
    assert times == sorted(times)
    assert len(frames) > 20
    for frame in frames:
        assert any((frame.image == sent).all() for sent in scene.frames)
        assert frame.exposure_end_us - frame.exposure_start_us == 4000
    g = np.concatenate([part.acceleration for part in imu])
    assert len(g) > 150
    np.testing.assert_allclose(g[:, 2], STANDARD_GRAVITY, rtol=2e-3)
    rotation = np.concatenate([part.angular_velocity for part in imu])
    np.testing.assert_allclose(rotation[:, 1], np.pi / 2, rtol=2e-3)
    assert counters.frames_dropped <= 1
    assert counters.words_unexpected == 0
    assert transport.stalls == 0
