# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Simulated time waits for the simulation and for the answers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_sim.grasp.live import AnswerPace, PacedClock

EPOCH_NS = 1_700_000_000_000_000_000
ORIGIN_US = 1_700_000_001_234_567


class Host:
    """A host clock that goes only when told."""

    def __init__(self) -> None:
        self.us = 0

    def ns(self) -> int:
        return 1000 * self.us

    def s(self) -> float:
        return 1e-6 * self.us


def make(host: Host, *paces: AnswerPace) -> PacedClock:
    clock = PacedClock(paces, host.ns, lambda: EPOCH_NS)
    clock.start()
    return clock


def test_goes_with_the_host_as_far_as_it_is_simulated_and_counts_the_rest() -> None:
    host = Host()
    clock = make(host)
    clock.reached(10_000)
    host.us = 7_000
    assert clock.now_us() == 7_000
    host.us = 25_000
    assert clock.now_us() == 10_000
    assert clock.lost_us == 15_000
    clock.reached(20_000)
    host.us = 29_000
    assert clock.now_us() == 14_000
    assert clock.to_epoch_ns(np.array([14_000])).tolist() == [EPOCH_NS + 14_000_000]


def test_waits_for_answers_only_while_somebody_answers() -> None:
    host = Host()
    pace = AnswerPace(4_000, 0.3, host.s)
    clock = make(host, pace)
    clock.reached(10_000_000)
    host.us = 50_000
    assert clock.now_us() == 50_000
    pace.answer(ORIGIN_US + 50_000, clock.now_us())
    host.us = 90_000
    assert clock.now_us() == 54_000
    host.us = 92_000
    pace.answer(ORIGIN_US + 52_000, clock.now_us())
    assert pace.lag_us == 2_000
    assert clock.now_us() == 54_000
    host.us = 93_000
    assert clock.now_us() == 55_000
    host.us = 500_000
    assert clock.now_us() == pytest.approx(462_000)


@given(
    st.lists(
        st.tuples(st.integers(0, 20_000), st.integers(0, 20_000), st.booleans()),
        min_size=1,
        max_size=60,
    )
)
def test_never_turns_back_and_never_passes_what_is_simulated(
    moves: list[tuple[int, int, bool]],
) -> None:
    host = Host()
    pace = AnswerPace(4_000, 0.03, host.s)
    clock = make(host, pace)
    reached = last = 0
    for passed, simulated, answers in moves:
        host.us += passed
        reached += simulated
        clock.reached(reached)
        now = clock.now_us()
        assert last <= now <= reached
        assert now + clock.lost_us == host.us
        last = now
        if answers:
            pace.answer(ORIGIN_US + max(now - simulated // 4, 0), now)


def test_a_restarted_camera_clock_is_taken_up() -> None:
    host = Host()
    pace = AnswerPace(4_000, 0.3, host.s)
    pace.answer(ORIGIN_US + 1_000_000, 1_000_000)
    pace.answer(ORIGIN_US + 5_000_000 + 1_100_000, 1_100_000)
    assert pace.limit_us() == 1_104_000
    pace.answer(ORIGIN_US + 1_200_000, 1_200_000)
    assert pace.limit_us() == 1_204_000
