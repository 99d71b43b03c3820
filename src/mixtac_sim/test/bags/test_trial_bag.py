# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A simulated bag against the real path: camera words, the driver's decoder, ROS's serialiser."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from usb.core import USBTimeoutError

from mixtac_core.events.codec import decode
from mixtac_core.recordings.bag import BagFile
from mixtac_core.recordings.dataset import TrialSpec
from mixtac_core.recordings.summary import summarise
from mixtac_driver.davis346.model import Geometry
from mixtac_driver.decode.decoder import StreamDecoder
from mixtac_sim.bags.messages import TrialClocks
from mixtac_sim.bags.trial_bag import write_trial
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.world.trial import TrialStream

SPEC = TrialSpec('press_one', 'press', 2.8, 11, 12, 'easy', 'train')
TRUTH = '/mixtac/truth/'


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp('bags')
    write_trial(SPEC, folder)
    return folder


@pytest.fixture(scope='module')
def bag(folder):
    with BagFile(folder / SPEC.name) as opened:
        yield opened


def stamp_ns(message):
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


@pytest.fixture(scope='module')
def events(bag):
    """Return the events of the bag as the standard decoder gives them [us]."""
    parts = [
        decode(m.events, m.encoding, int(m.time_base), width=m.width, height=m.height).events
        for _, _, m in bag.messages('/mixtac/events')
    ]
    return {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ('t', 'x', 'y', 'polarity')
    }


def registers(*settings):
    return b''.join(struct.pack('>BBI', *setting) for setting in settings), len(settings)


def through_the_camera(spec):
    """Send a trial through the words of the USB camera and the driver's decoder."""
    clocks, trial = TrialClocks(spec.trial_seed), TrialStream(spec)
    device = VirtualDavis346('00000011', skew_ppm=clocks.skew_ppm, clock=lambda: 0)
    run = ((0, 3, 1), (9, 0, 1), (0, 1, 1), (0, 0, 1), (9, 1, 0))
    sensors = ((1, 3, 1), (2, 4, 1), (3, 2, 1), (3, 3, 1), (3, 4, 1), (3, 7, 1), (3, 10, 1))
    for settings in (run, sensors):
        data, count = registers(*settings)
        device.control(0x40, 0xC2, count, 0, data)
    decoder = StreamDecoder(Geometry())
    for stretch in trial.stretches():
        device.submit(stretch.sensor.events, stretch.sensor.frames, stretch.readings)
        for now in range(stretch.start_us + 1000, stretch.end_us + 1, 1000):
            device.advance(now)
            try:
                data = device.read_bulk(0x82, 1 << 22, 0.0)
            except USBTimeoutError:
                continue
            yield from decoder.push(data)
    assert not any(device.losses.values())


@pytest.fixture(scope='module')
def decoded():
    names = ('t', 'x', 'y', 'polarity')
    events = {name: [] for name in names}
    frames, samples = [], []
    for batch in through_the_camera(SPEC):
        for name in names:
            events[name].append(getattr(batch.events, name).copy())
        frames += batch.frames
        if len(batch.imu.t):
            samples.append(batch.imu)
    return {name: np.concatenate(events[name]) for name in names}, frames, samples


def test_events_are_those_of_the_real_path(events, decoded):
    wanted, origin = decoded[0], TrialClocks(SPEC.trial_seed).origin_us
    count = len(events['t'])
    assert count > 50_000
    # The last packet of a stream stays open.
    assert len(wanted['t']) - count < 500
    assert np.array_equal(events['t'] - origin, wanted['t'][:count])
    for name in ('x', 'y', 'polarity'):
        assert np.array_equal(events[name], wanted[name][:count])


def test_frames_are_those_of_the_real_path(bag, decoded):
    frames, origin = decoded[1], TrialClocks(SPEC.trial_seed).origin_us
    images = [message for _, _, message in bag.messages('/mixtac/image_raw')]
    infos = [message for _, _, message in bag.messages('/mixtac/camera_info')]
    exposures = [message for _, _, message in bag.messages('/mixtac/image_exposure')]
    assert len(images) == len(infos) == len(exposures)
    assert 0 <= len(images) - len(frames) <= 1
    for image, info, exposure, frame in zip(images, infos, exposures, frames, strict=False):
        values = image.data.view('<u2').reshape(260, 346)
        assert np.array_equal(values >> 6, frame.image)
        assert not (values & 63).any()
        assert stamp_ns(image) == 1000 * (frame.middle_us + origin)
        assert stamp_ns(info) == stamp_ns(exposure) == stamp_ns(image)
        end = exposure.exposure_end
        assert end.sec * 10**9 + end.nanosec == 1000 * (frame.exposure_end_us + origin)
        assert image.encoding == 'mono16'


def test_inertial_samples_are_those_of_the_real_path(bag, decoded):
    origin = TrialClocks(SPEC.trial_seed).origin_us
    times = np.concatenate([samples.t for samples in decoded[2]])
    linear = np.concatenate([samples.acceleration for samples in decoded[2]])
    angular = np.concatenate([samples.angular_velocity for samples in decoded[2]])
    found = [message for _, _, message in bag.messages('/mixtac/imu/data_raw')]
    assert len(times) > 2700
    for index, message in enumerate(found[: len(times)]):
        assert stamp_ns(message) == 1000 * (times[index] + origin)
        vector, rates = message.linear_acceleration, message.angular_velocity
        assert [vector.x, vector.y, vector.z] == linear[index].tolist()
        assert [rates.x, rates.y, rates.z] == angular[index].tolist()


def test_the_bag_is_whole_and_says_that_it_is_simulated(folder, bag):
    summary = summarise(folder / SPEC.name)
    figures = summary.events['/mixtac/events']
    assert (figures.lost.packets_missing, figures.backward_steps) == (0, 0)
    assert summary.counts['/mixtac/camera_clock'] == 3
    assert abs(summary.counts['/ft_sensor/wrench'] - 2.8 * 800) < 10
    assert abs(summary.counts[TRUTH + 'wrench'] - 2800) < 5
    text = (folder / SPEC.name / 'metadata.yaml').read_text()
    assert 'mixtac.simulated' in text
    received = [when for _, when, _ in bag.messages('/mixtac/events')]
    assert received == sorted(received)


def test_true_clock_fit_maps_the_camera_onto_the_reference(bag):
    """The tap that begins the trial is at one moment on all clocks."""
    (_, _, fit), *_ = bag.messages(TRUTH + 'clock_fit')
    times, forces = bag.wrenches('/ft_sensor/wrench')
    true_times, true_forces = bag.wrenches(TRUTH + 'wrench')
    trial, clocks = TrialStream(SPEC), TrialClocks(SPEC.trial_seed)
    begin = true_times < clocks.epoch_ns + 1_000_000_000
    peak_us = (true_times[begin][true_forces[begin, 2].argmax()] - clocks.epoch_ns) // 1000
    camera_s = 1e-6 * (clocks.camera.now(int(peak_us)) + clocks.origin_us)
    expected = fit.a * (camera_s - fit.camera_epoch) + fit.b + trial.reference.delay_s
    near = np.abs(1e-9 * (times - clocks.epoch_ns) - expected) < 0.1
    measured = 1e-9 * (times[near][forces[near, 2].argmax()] - clocks.epoch_ns)
    assert abs(measured - expected) < 0.004


def test_transfers_arrive_in_order_however_they_are_asked_for():
    clocks = TrialClocks(3)
    arrivals = np.concatenate([clocks.arrivals_ns(np.array([50 * k])) for k in range(500)])
    assert (np.diff(arrivals) >= 0).all()
    assert len(clocks.arrivals_ns(np.zeros(0, np.int64))) == 0
