# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Frames and events: of one motion or of two, at the same time or one late."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from mixtac_fger.motion_agreement import RESTED, MotionAgreement, Pair, pair_of

SHAPE = 65, 86
NOISE, MURMUR = 0.014, 0.03


def moving(
    seed: int,
    late_frames: int = 0,
    late_events: int = 0,
    change: Callable[[np.ndarray], np.ndarray] = lambda told: told,
) -> Iterator[Pair]:
    """Yield pairs of a motion that starts, turns and stops, in noise."""
    random = np.random.default_rng(seed)
    one, other = random.normal(0.0, 0.3, (2, *SHAPE))
    time = np.linspace(0.0, 12.0, 60)
    states = [np.sin(t) ** 2 * one + 0.5 * np.sin(1.7 * t) ** 2 * other for t in time]

    def picture(index: int) -> np.ndarray:
        clean = states[max(index - late_frames, 0)]
        return np.float32(clean + random.normal(0.0, NOISE / math.sqrt(2.0), SHAPE))

    before = picture(0)
    for index in range(1, len(states)):
        after, place = picture(index), max(index - late_events, 1)
        told = 2.0 * change(states[place] - states[place - 1]) + random.normal(0.0, MURMUR, SHAPE)
        yield pair_of(before, after, np.float32(told), NOISE, MURMUR)
        before = after


def judged(pairs: Iterator[Pair], *, usable: bool = True) -> list[tuple[bool, bool]]:
    """Return what is said after each pair: apart, late."""
    agreement, found = MotionAgreement(), []
    for pair in pairs:
        agreement.pair(pair, usable=usable)
        found.append((agreement.apart, agreement.late))
    return found


@pytest.mark.parametrize('seed', range(5))
def test_one_motion_at_one_time(seed: int) -> None:
    assert set(judged(moving(seed))) == {(False, False)}


@pytest.mark.parametrize('late', [{'late_frames': 1}, {'late_frames': 2}, {'late_events': 1}])
@pytest.mark.parametrize('seed', range(5))
def test_frames_and_events_of_different_times(seed: int, late: dict[str, int]) -> None:
    assert any(of_time for _, of_time in judged(moving(seed, **late)))


WRONG = {
    'mirrored': lambda told: told[:, ::-1],
    'inverted': lambda told: -told,
    'upside down': lambda told: told[::-1],
}


@pytest.mark.parametrize('change', WRONG.values(), ids=WRONG)
def test_events_of_another_motion(change) -> None:
    found = [apart for apart, _ in judged(moving(3, change=change))]
    assert found[5:] == [True] * len(found[5:])


@pytest.mark.parametrize('change', WRONG.values(), ids=WRONG)
def test_what_cannot_be_compared_says_nothing(change) -> None:
    assert set(judged(moving(3, change=change), usable=False)) == {(False, False)}


def test_what_was_apart_agrees_again_or_rests_for_a_minute() -> None:
    def apart() -> MotionAgreement:
        agreement = MotionAgreement()
        for pair in moving(1, change=WRONG['mirrored']):
            agreement.pair(pair, usable=True)
        assert agreement.apart
        return agreement

    agreement = apart()
    for pair in moving(2):
        agreement.pair(pair, usable=True)
    assert not agreement.apart
    agreement, still = apart(), np.zeros(SHAPE, np.float32)
    for index in range(RESTED):
        assert agreement.apart, index
        agreement.pair(pair_of(still, still, still, NOISE, MURMUR), usable=True)
    assert not agreement.apart


def test_only_a_judgement_is_certain() -> None:
    right, wrong = MotionAgreement(), MotionAgreement()
    certain = set()
    for pair, other in zip(moving(4), moving(4, change=WRONG['inverted']), strict=True):
        right.pair(pair, usable=True)
        wrong.pair(other, usable=True)
        certain.add(right.certain)
        assert not wrong.certain
    assert certain == {True, False}


def test_shares_of_signal_are_those_of_the_variance() -> None:
    random = np.random.default_rng(0)
    before, told = (random.normal(0.0, s, SHAPE).astype(np.float32) for s in (0.1, 0.5))
    pair = pair_of(before, 0.0 * before, told, 0.05, 0.4)
    assert pair.change == pytest.approx(before.std(), rel=1e-4)
    assert pair.changed == pytest.approx(1.0 - (0.05 / before.std()) ** 2, rel=1e-4)
    assert pair.moved == pytest.approx(1.0 - (0.4 / told.std()) ** 2, rel=1e-4)
    assert pair_of(before, before, told, 0.05, 0.4).changed == 0.0
    assert pair_of(before, 0.0 * before, told, 0.0, 0.0)[-2:] == (0.0, 0.0)
