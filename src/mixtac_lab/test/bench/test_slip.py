# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which arrivals answer a knock, on made-up arrivals, and the figure of the curves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from matplotlib import image

from mixtac_lab.bench.slip import HORIZON_NS, draw_curves, match_knocks

if TYPE_CHECKING:
    from pathlib import Path

MS = 1_000_000
ORIGIN = 5_000_000 * MS
SCENE = {
    'period_us': 4_000_000,
    'onsets_us': [1_000_000, 2_000_000, 3_000_000],
    'speeds_mm_s': [30.0, 60.0, 90.0],
}
SECOND = 1000 * MS


def match(slips, sent, spans, span=(ORIGIN, ORIGIN + 4 * SECOND)):
    noted = {
        'slips_ns': sorted(slips),
        'trajectories_ns': sorted(sent),
        'enabled_spans_ns': spans,
        'windows': 4000,
        'stops': 0,
    }
    return match_knocks(SCENE, noted, ORIGIN, span, 0, {})


def test_each_knock_is_matched_with_what_follows_it() -> None:
    slips = [ORIGIN + SECOND + 2 * MS, ORIGIN + 2 * SECOND + 3 * MS]
    sent = [ORIGIN + SECOND + 5 * MS, ORIGIN + SECOND + 7 * MS]
    found = match(slips, sent, [(ORIGIN, ORIGIN + int(2.5 * SECOND))])
    assert found['speeds_mm_s'] == [30.0, 60.0, 90.0]
    assert found['detection_ms'][:2] == pytest.approx([2.0, 3.0])
    assert found['detection_ms'][2] is None
    assert found['publish_ms'][0] == pytest.approx(5.0)
    # The second was not answered; before the third, slip control was not enabled.
    assert found['publish_ms'][1] is None
    assert len(found['publish_ms']) == 2
    missed = ('not_ready', 'missed_detections', 'missed_answers')
    assert [found[name] for name in missed] == [1, 1, 1]
    assert found['false_alarms'] == 0


def test_an_arm_in_motion_answers_nothing_and_a_slip_without_a_knock_is_an_alarm() -> None:
    always = [(ORIGIN, ORIGIN + 4 * SECOND)]
    sent = [ORIGIN + SECOND - 20 * MS, ORIGIN + SECOND + MS]
    found = match([ORIGIN + SECOND // 2], sent, always)
    assert found['false_alarms'] == 1
    assert found['not_ready'] == 1
    assert len(found['publish_ms']) == 2


def test_an_answer_beyond_the_horizon_is_none_and_periods_repeat() -> None:
    late = ORIGIN + SECOND + HORIZON_NS + 1
    next_period = ORIGIN + 5 * SECOND + 4 * MS
    found = match([late, next_period], [], [], (ORIGIN, ORIGIN + 6 * SECOND))
    assert found['speeds_mm_s'] == [30.0, 60.0, 90.0, 30.0, 60.0]
    assert found['detection_ms'][0] is None
    assert found['detection_ms'][3] == pytest.approx(4.0)
    assert found['false_alarms'] == 1


def test_an_answer_to_a_knock_before_the_measurement_is_no_alarm() -> None:
    span = (ORIGIN + SECOND + MS, ORIGIN + 4 * SECOND)
    found = match([ORIGIN + SECOND + 2 * MS], [], [], span)
    assert found['speeds_mm_s'] == [60.0, 90.0]
    assert found['false_alarms'] == 0


def test_curves_are_drawn_where_a_detector_missed_everything(tmp_path: Path) -> None:
    curve = {
        'false_alarms_per_min': [3.0, 1.0, 0.0],
        'latency_ms': [0.8, 1.2, None],
        'shipped': {'latency_p50_ms': 1.2, 'false_alarms_per_min': 1.0},
    }
    missed = curve | {'shipped': {'latency_p50_ms': None, 'false_alarms_per_min': 0.0}}
    path = tmp_path / 'curves.png'
    draw_curves(path, {'10_mm_s': {'flow': curve, 'count': missed}})
    assert image.imread(path).std() > 0.05
