# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The checks before a recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixtac_cli.record.meter import TopicMeter
from mixtac_cli.record.session import (
    check_clocks,
    check_disk,
    check_topics,
    free_bytes,
)
from mixtac_driver.doctor import Level
from mixtac_node.topics import TOPICS

if TYPE_CHECKING:
    from pathlib import Path

OK, WARN, ERROR = Level
NOW_NS = 1_790_000_000_000_000_000
GIB = 1 << 30


def meter(name: str, messages: int, missing: int = 0) -> TopicMeter:
    (topic,) = (each for each in TOPICS if each.name == name)
    return TopicMeter(topic, even=False, messages=messages, missing=missing)


def test_a_recording_that_does_not_fit_is_refused():
    assert check_disk(2 * GIB, 10e6, 60).level == OK
    assert check_disk(2 * GIB, 10e6, 3600).level == ERROR
    assert check_disk(GIB // 2, 10e6, 1).level == ERROR
    assert check_disk(5 * GIB, 10e6, 0).level == WARN
    assert check_disk(500 * GIB, 10e6, 0).level == OK


def test_free_space_of_a_folder_that_is_not_there_is_that_of_its_disk(tmp_path: Path):
    assert free_bytes(tmp_path / 'a' / 'b') > 0


def test_topics_are_judged_by_publishers_arrivals_and_rates():
    meters = [
        meter('events', 2000),
        meter('image_raw', 0),
        meter('force', 100),
        meter('imu/data_raw', 2000, missing=3),
        meter('slip', 0),
    ]
    publishers = {'events': 1, 'image_raw': 1, 'force': 1, 'imu/data_raw': 1, 'slip': 0}
    found = {f.name: f.level for f in check_topics(meters, publishers, 2.0)}
    assert found == {'events': OK, 'image_raw': ERROR, 'force': WARN, 'imu/data_raw': WARN}


def test_no_sensor_and_two_sensors_are_errors():
    (finding,) = check_topics([meter('events', 0)], {'events': 0}, 2.0)
    assert finding.level == ERROR
    (finding,) = check_topics([meter('events', 4000)], {'events': 2}, 2.0)
    assert finding.level == ERROR


def levels(*args, **options):
    return [finding.level for finding in check_clocks(*args, **options)]


def test_clocks_that_agree_pass_and_others_do_not():
    near = {'image_raw': NOW_NS - 30_000_000, 'imu/data_raw': NOW_NS - 2_000_000}
    assert levels(NOW_NS, near) == [OK]
    assert levels(NOW_NS, {**near, 'force': NOW_NS - 10**11}) == [ERROR, WARN]
    old = {name: stamp - 10**12 for name, stamp in near.items()}
    assert levels(NOW_NS, old) == [WARN]
    assert levels(NOW_NS, old, simulated_time=True) == [WARN, OK]
    assert levels(10**9, {}) == [ERROR]
