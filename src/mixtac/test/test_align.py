# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The bag tool on a made-up bag whose clocks are known."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

pytest.importorskip('mixtac_msgs.msg', reason='needs the built workspace')

from mixtac.align import align_bag
from mixtac.main import main
from mixtac_core.events.arrays import Events
from mixtac_core.events.errors import MixtacError
from mixtac_core.events.readings import Edges
from mixtac_core.node import topics
from mixtac_core.recordings.bag import BagFile, blank_message, custom_data, fit_path
from mixtac_core.recordings.bag_writer import McapBag
from mixtac_core.recordings.importing import StreamWriter
from mixtac_core.recordings.messages import set_header
from mixtac_core.recordings.recording import RecordingError
from mixtac_fger.alignment.bags import read_fit, rewrite_bag
from mixtac_fger.alignment.clock_fit import AlignmentError, ClockFit

if TYPE_CHECKING:
    from pathlib import Path

START_US, REFERENCE_S, LATENCY_S = 1_700_000_000_000_000, 1_690_000_123.25, 2.4e-3
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


def polarity_of(t_us: np.ndarray, x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return polarities: the left half brightens with the force, the right half darkens."""
    t = (t_us - START_US) * 1e-6 - LATENCY_S
    slope = force_at(t + 5e-5) - force_at(t - 5e-5)
    return np.where(slope == 0.0, rng.random(len(t)) < 0.5, (slope > 0.0) == (x < 150))


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the bag."""
    path = tmp_path_factory.mktemp('align') / 'trial'
    rng = np.random.default_rng(4)
    times = events_us(rng)
    borders = np.arange(START_US, START_US + 8_010_000, 10_000)
    cuts = np.searchsorted(times, borders)
    with McapBag(path) as written:
        writer = StreamWriter(written, (346, 260))
        for k in range(len(borders) - 1):
            t = times[cuts[k] : cuts[k + 1]]
            x = (np.arange(len(t)) % 300).astype(np.uint16)
            events = Events(t, x, x // 2, polarity_of(t, x, rng))
            writer.events(events, int(borders[k + 1]), 1_000_000_000 + 10_000_000 * k)
        for k, t_s in enumerate(np.arange(0.0, 8.0, 1.0 / 800.0)):
            values = np.zeros(6)
            values[2] = force_at(np.array([t_s]))[0] + rng.normal(0.0, 0.01)
            stamp_ns = round(1e9 * (REFERENCE_S + RATE * t_s))
            received_ns = 1_000_000_000 + 1_250_000 * k
            data = topics.WrenchWriter('').serialised(stamp_ns, values.tolist())
            writer.put(topics.REFERENCE_WRENCH, received_ns, data)
    return path


def test_the_clocks_are_found_and_the_fit_lies_beside_the_bag(bag: Path) -> None:
    found, damage = align_bag(bag)
    assert damage == ''
    fit = read_fit(bag)
    camera = START_US + np.array([0, 4_000_000, 8_000_000])
    truth = REFERENCE_S + RATE * (camera - START_US) * 1e-6
    assert np.abs(fit.to_reference(camera) - truth).max() < 1.5e-3
    assert fit.a == found.a
    assert json.loads(fit_path(bag).read_text())['method'] == 'two_impulse'


def test_copies_have_the_force_on_the_camera_clock(bag: Path, tmp_path: Path) -> None:
    fit, _ = align_bag(bag, copy=tmp_path / 'one' / 'trial')
    with BagFile(bag) as old, BagFile(tmp_path / 'one' / 'trial') as new:
        assert new.counts['/mixtac/events'] == old.counts['/mixtac/events']
        assert new.counts['/mixtac/clock_fit'] == 1
        before, force = old.wrenches('/ft_sensor/wrench')
        after, same = new.wrenches('/ft_sensor/wrench')
        ((_, _, message),) = new.messages('/mixtac/clock_fit')
    own = ClockFit.from_fields(vars(message))
    assert np.abs(own.stamp_to_camera_us(after) - after / 1e3).max() < 1.0
    assert own.std_at(START_US) == fit.std_at(START_US)
    assert force.tolist() == same.tolist()
    shown_us = (before - round(REFERENCE_S * 1e9)) / RATE / 1e3
    assert np.abs(after / 1e3 - START_US - shown_us).max() < 1500.0
    with pytest.raises(MixtacError) as caught:
        align_bag(bag, copy=tmp_path / 'one' / 'trial')
    assert 'new' in str(caught.value)


def test_bags_of_one_name_have_copies_of_their_own(bag: Path, tmp_path: Path) -> None:
    for folder in ('static', 'dynamic'):
        shutil.copytree(bag, tmp_path / 'data' / folder / bag.name)
    table, names = tmp_path / 'table.json', {'static_trial', 'dynamic_trial'}
    copies = tmp_path / 'copies'
    words = ['--rewrite', str(copies), '--json', str(table)]
    assert main(['align', *words, str(tmp_path / 'data')]) == 0
    assert {each['bag'] for each in json.loads(table.read_text())} == names
    assert {each.name for each in copies.iterdir()} == names


def test_a_copy_keeps_what_was_said_of_the_bag_and_has_no_fit_of_another(
    bag: Path, tmp_path: Path
) -> None:
    (fit, _), said = align_bag(bag), {'mixtac.simulated': 'true'}
    with McapBag(tmp_path / 'said') as writer:
        writer.custom_data.update(said)
    out = tmp_path / 'copy'
    rewrite_bag(tmp_path / 'said', fit, out, topics.REFERENCE, '/mixtac')
    assert custom_data(out) == said
    shutil.rmtree(out)
    fit_path(out).write_text('{}')
    with pytest.raises(RecordingError):
        rewrite_bag(tmp_path / 'said', fit, out, topics.REFERENCE, '/mixtac')


def test_what_cannot_be_aligned_is_refused_with_the_reason(bag: Path, tmp_path: Path) -> None:
    refused = tmp_path / 'refused.json'
    assert main(['align', str(bag), '--reference-topic', '/other', '--json', str(refused)]) == 1
    assert '/other' in json.loads(refused.read_text())[0]['refused']
    with pytest.raises(AlignmentError) as caught:
        read_fit(tmp_path / 'none')
    assert 'mixtac align' in caught.value.remedy
    for content in ('[1, 2]', '{"schema": 1, "a": null}'):
        fit_path(bag).write_text(content)
        with pytest.raises(AlignmentError) as caught:
            read_fit(bag)
        assert str(fit_path(bag)) in caught.value.message
        assert 'mixtac align' in caught.value.remedy


@pytest.fixture
def edges_bag(tmp_path: Path) -> Path:
    """Write a bag with nothing but edges of a trigger line on both clocks."""
    path = tmp_path / 'edges'
    reference = replace(topics.CAMERA_CLOCK, name='reference_edges')
    with McapBag(path) as written:
        writer = StreamWriter(written, (346, 260))
        for k, t_s in enumerate(np.cumsum(np.random.default_rng(2).uniform(0.3, 0.9, 20))):
            t_us = START_US + round(1e6 * t_s)
            writer.edges(Edges(np.array([t_us]), np.zeros(1, np.uint8)), 0, k)
            message = blank_message(reference.type_name)
            set_header(message, 1000 * t_us, '')
            other = REFERENCE_S + RATE * t_s
            message.time_ref.sec, message.time_ref.nanosec = int(other), round(other % 1.0 * 1e9)
            writer.put(reference, k, message)
    return path


def test_edges_of_a_trigger_line_serve_in_place_of_taps(edges_bag: Path, bag: Path) -> None:
    fit, _ = align_bag(edges_bag, method='edges')
    camera = START_US + np.array([0, 5_000_000, 10_000_000])
    truth = REFERENCE_S + RATE * (camera - START_US) * 1e-6
    assert np.abs(fit.to_reference(camera) - truth).max() < 5e-6
    with pytest.raises(MixtacError) as caught:
        align_bag(bag, method='edges')
    assert 'external_edges' in str(caught.value)
