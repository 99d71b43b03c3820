# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The grasp as the virtual sensor runs it, and the clock that waits for it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_sim.grasp.live import AnswerPace, LiveGrasp, PacedClock
from mixtac_sim.grasp.objects import draw_setup
from mixtac_sim.pixels.aps import ApsSettings
from mixtac_sim.world.effects import EASY


@pytest.fixture
def grasp() -> LiveGrasp:
    return LiveGrasp(draw_setup('box', np.random.default_rng(0)), 1, 1, EASY, PacedClock())


def test_its_clock_waits_for_it() -> None:
    host_ns = 0
    clock = PacedClock((), lambda: host_ns, lambda: 0)
    clock.start()
    grasp = LiveGrasp(draw_setup('box', np.random.default_rng(0)), 1, 1, EASY, clock)
    host_ns = 9_000_000
    assert clock.now_us() == 0
    grasp.advance(4_000)
    host_ns = 18_000_000
    assert clock.now_us() == 4_000


def test_holds_until_it_is_struck_and_can_be_put_back(grasp: LiveGrasp) -> None:
    quiet = grasp.advance(40_000).events.t >= 20_000
    assert abs(grasp.object_mm) < 0.01
    grasp.strike(60.0)
    struck = grasp.advance(60_000)
    assert grasp.object_mm > 0.3
    assert len(struck.events) > 2 * np.count_nonzero(quiet)
    grasp.put_back()
    grasp.advance(64_000)
    assert abs(grasp.object_mm) < 0.05


def test_what_is_put_back_is_held_again_with_the_force_of_the_grasp(grasp: LiveGrasp) -> None:
    grasp.advance(20_000)
    grasp.strike(60.0)
    grasp.move(0.3)
    grasp.advance(200_000)
    # The fingertip jumps back at once, as where the arm's place is counted anew.
    grasp.put_back()
    grasp.move(0.0)
    force = []
    for until_us in range(204_000, 2_600_000, 4_000):
        force.append(grasp.advance(until_us).truth['fz'][-1])
        assert abs(grasp.object_mm) < 0.05
    assert force[-1] == pytest.approx(grasp.grasp_n, rel=0.02)
    assert min(force) > 0.95 * grasp.grasp_n


def test_it_reports_where_the_fingertip_is_and_since_when(grasp: LiveGrasp) -> None:
    before = grasp.advance(8_000).truth['fz'][-1]
    assert grasp.take_reached(8_000) == []
    grasp.move(0.1, (1.0, 2.0))
    assert grasp.advance(12_000).truth['fz'][-1] > 1.1 * before
    grasp.advance(20_000)
    grasp.move(0.2, (3.0, 4.0))
    grasp.advance(24_000)
    assert grasp.take_reached(16_000) == [(12_000, (1.0, 2.0)), (16_000, (1.0, 2.0))]
    assert grasp.take_reached(24_000) == [(20_000, (1.0, 2.0)), (24_000, (3.0, 4.0))]


def test_it_can_begin_open_and_close_on_what_a_hand_holds() -> None:
    setup = draw_setup('box', np.random.default_rng(0))
    grasp = LiveGrasp(setup, 1, 1, EASY, PacedClock(), open_first=True)
    free = grasp.advance(200_000)
    assert not free.truth['fz'].any()
    assert not free.wrench[:, 1].any()
    grasp.move(0.1)
    grasp.put_back()
    closing = grasp.advance(700_000)
    assert grasp.object_mm == 0.0
    assert np.all(np.diff(closing.truth['fz']) > -0.02 * grasp.grasp_n)
    # Frames of both: the beads are elsewhere.
    before, after = (part.frames[-1].intensity.astype(float) for part in (free, closing))
    noise = np.abs(free.frames[-1].intensity.astype(float) - free.frames[-2].intensity)
    assert np.abs(after - before).mean() > 1.5 * noise.mean()
    # The hand lets go: skin and wall hold it.
    held = grasp.advance(3_000_000)
    assert held.truth['fz'][-1] == pytest.approx(grasp.grasp_n, rel=0.05)
    assert held.truth['fy'][-1] > 0.1
    assert grasp.object_mm < 0.5


def test_output_is_on_time_and_at_its_rates(grasp: LiveGrasp) -> None:
    grasp.configure_aps(ApsSettings(5_000, 30_000, 2_000))
    parts = [grasp.advance(until) for until in range(4_000, 104_000, 4_000)]
    truth = np.concatenate([part.truth['t_us'] for part in parts])
    assert np.array_equal(truth, 1000 * (np.arange(100) + 1))
    frames = [frame for part in parts for frame in part.frames]
    assert [f.exposure_start_us for f in frames] == [5_000, 35_000, 65_000]
    times = np.concatenate([part.events.t for part in parts])
    assert np.all(np.diff(times) >= 0)
    assert len(parts[0].wrench_us) == 32


EPOCH_NS = 1_700_000_000_000_000_000
ORIGIN_US = 1_700_000_001_234_567


class Host:
    """A host clock that goes only when a test moves it."""

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
