# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The bag tool on a made-up bag whose clocks are known."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

pytest.importorskip('mixtac_msgs.msg', reason='needs the built workspace')

from rosbags.rosbag2 import StoragePlugin, Writer

from mixtac_alignment.bags import fit_path, read_fit, read_recording, sensor_of
from mixtac_alignment.errors import AlignmentError
from mixtac_cli.align import align_bag
from mixtac_events.arrays import Events
from mixtac_events.codec import encode
from mixtac_recordings.bag import BagFile, typestore

if TYPE_CHECKING:
    from pathlib import Path

START_US, REFERENCE_S, LATENCY_S = 1_700_000_000_000_000, 1_690_000_123.25, 4.15e-3
TAPS_S = (1.0, 7.0)
RATE = 1.0 + 50e-6


def force_at(t: np.ndarray) -> np.ndarray:
    """Return two taps of 20 ms [N]."""
    taps = [2.0 * np.cos(np.pi * np.clip((t - at) / 0.02, -0.5, 0.5)) ** 1.5 for at in TAPS_S]
    return np.asarray(sum(taps))


def events_us(rng: np.random.Generator) -> np.ndarray:
    """Return event times on the camera clock [us]."""
    t = np.arange(0.0, 8.0, 1e-4)
    rate = 2e4 + 9e3 * np.abs(np.gradient(force_at(t), 1e-4))
    count = rng.poisson(rate * 1e-4)
    times = np.repeat(t, count) + rng.uniform(0.0, 1e-4, count.sum()) + LATENCY_S
    return START_US + np.sort(np.rint(times * 1e6)).astype(np.int64)


def packet(types: Any, number: int, t: np.ndarray, until: int) -> bytes:
    """Return a serialised event packet."""
    n = len(t)
    x = (np.arange(n) % 300).astype(np.uint16)
    encoded = encode(Events(t, x, x // 2, np.ones(n, np.bool_)), complete_until=until)
    kinds = types.types
    header = kinds['std_msgs/msg/Header'](kinds['builtin_interfaces/msg/Time'](0, 0), '')
    message = kinds['event_camera_msgs/msg/EventPacket'](
        header=header,
        height=260,
        width=346,
        seq=number,
        time_base=encoded.time_base,
        encoding=encoded.encoding,
        is_bigendian=False,
        events=np.frombuffer(encoded.payload, np.uint8),
    )
    return bytes(types.serialize_cdr(message, 'event_camera_msgs/msg/EventPacket'))


def wrench(types: Any, t_s: float, force: float) -> bytes:
    """Return a serialised reference sample."""
    kinds = types.types
    whole = int(t_s)
    stamp = kinds['builtin_interfaces/msg/Time'](whole, round((t_s - whole) * 1e9))
    zero = kinds['geometry_msgs/msg/Vector3'](0.0, 0.0, 0.0)
    push = kinds['geometry_msgs/msg/Vector3'](0.0, 0.0, force)
    message = kinds['geometry_msgs/msg/WrenchStamped'](
        header=kinds['std_msgs/msg/Header'](stamp, ''),
        wrench=kinds['geometry_msgs/msg/Wrench'](push, zero),
    )
    return bytes(types.serialize_cdr(message, 'geometry_msgs/msg/WrenchStamped'))


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the bag."""
    path, types = tmp_path_factory.mktemp('align') / 'trial', typestore()
    rng = np.random.default_rng(4)
    times = events_us(rng)
    borders = np.arange(START_US, START_US + 8_010_000, 10_000)
    cuts = np.searchsorted(times, borders)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        events = writer.add_connection(
            '/mixtac/events', 'event_camera_msgs/msg/EventPacket', typestore=types
        )
        force = writer.add_connection(
            '/ft_sensor/wrench', 'geometry_msgs/msg/WrenchStamped', typestore=types
        )
        for k in range(len(borders) - 1):
            data = packet(types, k, times[cuts[k] : cuts[k + 1]], int(borders[k + 1]))
            writer.write(events, 1_000_000_000 + 10_000_000 * k, data)
        for k, t in enumerate(np.arange(0.0, 8.0, 1.0 / 800.0)):
            value = float(force_at(np.array([t]))[0] + rng.normal(0.0, 0.01))
            data = wrench(types, REFERENCE_S + RATE * float(t), value)
            writer.write(force, 1_000_000_000 + 1_250_000 * k, data)
    return path


def test_the_clocks_are_found_and_the_fit_lies_beside_the_bag(bag: Path) -> None:
    outcome = align_bag(bag)
    assert outcome.fit is not None, outcome.reason
    fit = read_fit(bag)
    camera = START_US + np.array([0, 4_000_000, 8_000_000])
    truth = REFERENCE_S + RATE * (camera - START_US) * 1e-6
    assert np.abs(fit.to_reference(camera) - truth).max() < 1.5e-3
    assert fit.a == outcome.fit.a
    assert json.loads(fit_path(bag).read_text())['method'] == 'two_impulse'


def test_copies_have_the_force_on_the_camera_clock(bag: Path, tmp_path: Path) -> None:
    options = {'rewrite': tmp_path / 'one', 'figures': tmp_path / 'figures'}
    outcome = align_bag(bag, **options)
    assert outcome.fit is not None, outcome.reason
    assert (tmp_path / 'figures' / 'trial.png').stat().st_size > 10_000
    with BagFile(bag) as old, BagFile(tmp_path / 'one' / 'trial') as new:
        assert new.counts['/mixtac/events'] == old.counts['/mixtac/events']
        assert new.counts['/mixtac/clock_fit'] == 1
        before, force = old.wrenches('/ft_sensor/wrench')
        after, same = new.wrenches('/ft_sensor/wrench')
    assert force.tolist() == same.tolist()
    shown_us = (before - round(REFERENCE_S * 1e9)) / RATE / 1e3
    assert np.abs(after / 1e3 - START_US - shown_us).max() < 1500.0
    again = align_bag(bag, **options)
    assert again.fit is None
    assert 'new' in again.reason


def test_what_cannot_be_aligned_is_refused_with_the_reason(bag: Path, tmp_path: Path) -> None:
    outcome = align_bag(bag, reference='/other')
    assert outcome.fit is None
    assert '/other' in outcome.reason
    with pytest.raises(AlignmentError) as caught:
        read_fit(tmp_path / 'none')
    assert 'mixtac align' in caught.value.remedy
    fit_path(bag).write_text('[1, 2]')
    with pytest.raises(AlignmentError):
        read_fit(bag)


def test_counts_are_those_of_the_events(bag: Path) -> None:
    recording = read_recording(bag)
    assert recording.frames is None
    written = events_us(np.random.default_rng(4)) < START_US + 8_000_000
    assert int(recording.counts.counts.sum()) == int(written.sum())
    assert recording.counts.lost == ()


@pytest.fixture
def edges_bag(tmp_path: Path) -> Path:
    """Write a bag with nothing but edges of a trigger line on both clocks."""
    path, types = tmp_path / 'edges', typestore()
    kinds = types.types
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        camera = writer.add_connection(
            '/mixtac/external_edges', 'mixtac_msgs/msg/ExternalEdge', typestore=types
        )
        reference = writer.add_connection(
            '/mixtac/reference_edges', 'sensor_msgs/msg/TimeReference', typestore=types
        )
        for k, t in enumerate(np.cumsum(np.random.default_rng(2).uniform(0.3, 0.9, 20))):
            us = START_US + round(1e6 * float(t))
            stamp = kinds['builtin_interfaces/msg/Time'](us // 10**6, us % 10**6 * 1000)
            edge = kinds['mixtac_msgs/msg/ExternalEdge']
            header = kinds['std_msgs/msg/Header'](stamp, '')
            fields = {
                name: 0
                for name in edge.__dataclass_fields__
                if name not in ('header', '__msgtype__')
            }
            writer.write(
                camera, k, types.serialize_cdr(edge(header=header, **fields), edge.__msgtype__)
            )
            other = REFERENCE_S + RATE * float(t)
            time = kinds['builtin_interfaces/msg/Time'](int(other), round(other % 1.0 * 1e9))
            message = kinds['sensor_msgs/msg/TimeReference'](header, time, 'trigger')
            writer.write(reference, k, types.serialize_cdr(message, message.__msgtype__))
    return path


def test_edges_of_a_trigger_line_serve_in_place_of_taps(edges_bag: Path, bag: Path) -> None:
    outcome = align_bag(edges_bag, method='edges')
    assert outcome.fit is not None, outcome.reason
    camera = START_US + np.array([0, 5_000_000, 10_000_000])
    truth = REFERENCE_S + RATE * (camera - START_US) * 1e-6
    assert np.abs(outcome.fit.to_reference(camera) - truth).max() < 5e-6
    refused = align_bag(bag, method='edges')
    assert refused.fit is None
    assert 'external_edges' in refused.reason


def test_the_sensor_of_a_bag_stands_in_the_data_set(tmp_path: Path) -> None:
    assert sensor_of(tmp_path / 'a') is None
    text = 'trials: [{name: a, device_seed: 7}, {name: b, serial: x1}, {name: c, serial: ""}]'
    (tmp_path / 'dataset.yaml').write_text(text)
    assert [sensor_of(tmp_path / name) for name in 'abcd'] == ['7', 'x1', None, None]
