# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The demo's second part: errors, windows without a sideways force, path, and picture."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_cli.demo.drawing import draw_run
from mixtac_cli.demo.evaluation import Comparison
from mixtac_cli.demo.sideways import SidewaysRun, read_sideways, true_path
from mixtac_events.arrays import Events
from mixtac_node import topics
from mixtac_recordings.bag import blank_message
from mixtac_recordings.bag_writer import McapBag
from mixtac_recordings.messages import set_header
from mixtac_recordings.stream_writer import StreamWriter
from mixtac_sim.world.device import draw_conditions
from mixtac_sim.world.effects import preset

WINDOW_NS = 2_000_000
HOST_NS = 5_000_000_000
"""The host's clock at camera time 0."""


def run_of(truth, force, unknown=0) -> SidewaysRun:
    count = len(truth)
    return SidewaysRun(
        time_s=0.002 * np.arange(count),
        force_n=np.array(force, np.float64),
        truth_n=np.array(truth, np.float64),
        unknown=unknown,
        place_mm=np.zeros((1, 2)),
        path_mm=np.zeros((2, 2)),
    )


def test_only_windows_in_contact_count():
    run = run_of(
        [(9.0, 9.0, 0.0), (0.3, -0.4, 0.5), (0.1, 0.0, 0.5)], [(0, 0), (0.2, -0.4), (0, 0)]
    )
    figures = run.figures
    assert figures['sideways_mae_n'] == pytest.approx(0.05)
    assert figures['sideways_size_n'] == pytest.approx(0.2)
    assert figures['sideways_peak_n'] == pytest.approx(0.5)


def test_no_error_is_known_without_a_known_force():
    figures = run_of(np.zeros((0, 3)), np.zeros((0, 2)), unknown=7).figures
    assert figures['sideways_mae_n'] is None
    assert figures['sideways_unknown'] == 7


def test_the_path_begins_where_the_sensor_is_touched_and_moves_both_ways():
    path = true_path(1001, 'paper_like')
    right, down = draw_conditions(1001, preset('paper_like')).contact_mm
    assert path[0] == pytest.approx((right, -down), abs=1e-3)
    assert 1.0 < np.ptp(path, axis=0).max() < 4.0


def write_run(folder, known) -> None:
    """Write a bag of windows that press by 0.5 N and pull by 0.2 N, found as 0.1 N."""
    pixel, size = np.zeros(1, np.uint16), (346, 260)
    pressed, pulled = np.array([0.1, 0, 0.5, 0, 0, 0]), np.array([0.2, 0, 0.5, 0, 0, 0])
    with McapBag(folder) as bag:
        writer = StreamWriter(bag, size)

        def put(topic, stamp_ns, **values):
            message = blank_message(topic.type_name)
            set_header(message, stamp_ns, '')
            for name, value in values.items():
                setattr(message, name, value)
            writer.put(topic, stamp_ns, message)

        for index in range(1, 21):
            camera_ns = WINDOW_NS * index
            t = np.array([2000 * index - 1], np.int64)
            events = Events(t, pixel, pixel, np.ones(1, np.bool_))
            writer.events(events, 2000 * index, HOST_NS + camera_ns)
            place = blank_message('geometry_msgs/msg/Point')
            place.x, place.y = 1e-3, -2e-3
            put(topics.FORCE_QUALITY, camera_ns, sideways_known=known(index))
            put(topics.CONTACT, camera_ns, located=True, position=place)
            for topic, stamp_ns, force in (
                (topics.FORCE, camera_ns, pressed),
                (topics.REFERENCE_WRENCH, camera_ns, pressed),
                (topics.TRUTH_WRENCH, HOST_NS + camera_ns, pulled),
            ):
                writer.wrench(topic, stamp_ns, force, '', stamp_ns)


def test_a_bag_is_compared_with_the_simulated_force(tmp_path):
    write_run(tmp_path / 'bag', known=lambda index: index % 4 > 0)
    run = read_sideways(tmp_path / 'bag', 'mixtac', np.zeros((2, 2)))
    figures = run.figures
    assert figures['sideways_mae_n'] == pytest.approx(0.05)
    assert len(run.time_s) + run.unknown in (19, 20)
    assert run.unknown in (4, 5)
    np.testing.assert_allclose(run.place_mm, [[1.0, -2.0]] * 20)


@pytest.mark.parametrize('count', [0, 20])
def test_the_picture_shows_both_parts(tmp_path, count):
    time_s = np.linspace(0.0, 3.0, 50)
    comparison = Comparison(
        fit=None,
        start_us=0,
        time_s=time_s,
        estimate_n=np.sin(time_s),
        reference_n=np.sin(time_s),
        sample_s=time_s,
        sample_n=np.sin(time_s),
        zeros_n=(0.0, 0.0),
        rmse_n=0.0,
        constant_mae_n=0.0,
    )
    truth, force = np.full((count, 3), 0.2), np.full((count, 2), 0.1)
    run = run_of(truth, force)
    path = tmp_path / 'demo.png'
    draw_run(path, comparison, (time_s, 1.0 + time_s), [('press', 0.0, 1.0)], 'simulated', run)
    assert path.read_bytes().startswith(b'\x89PNG')
