# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The stand-in for message_filters, by itself and beside the released package."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

PATH = Path(__file__).parents[1] / 'compat/message_filters/message_filters/__init__.py'


def load(path):
    spec = importlib.util.spec_from_file_location('stand_in', path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


OURS = load(PATH)


pytest.importorskip('builtin_interfaces.msg', reason='needs ROS 2')


def message(number, stamp_ns):
    """Return a message with a stamp; its number distinguishes it from others of this stamp."""
    from builtin_interfaces.msg import Time

    stamp = Time(sec=0, nanosec=stamp_ns)
    return SimpleNamespace(number=number, stamp_ns=stamp_ns, header=SimpleNamespace(stamp=stamp))


def outputs(filters, make, arrivals, inputs):
    sources = [filters.SimpleFilter() for _ in range(inputs)]
    synchroniser, got = make(filters, sources), []
    synchroniser.registerCallback(lambda *messages: got.append(messages))
    for number, (source, stamp) in enumerate(arrivals):
        sources[source].signalMessage(message(number, stamp))
    return got


def exact(filters, sources):
    return filters.TimeSynchronizer(sources, 4)


def near(filters, sources):
    return filters.ApproximateTimeSynchronizer(sources, 4, 3e-9)


def test_sets_of_one_stamp_come_in_any_order_and_lost_partners_are_left_out():
    arrivals = [(0, 1), (1, 2), (1, 1), (0, 3), (0, 2), (1, 4), (1, 3)]
    got = outputs(OURS, exact, arrivals, 2)
    assert [(a.stamp_ns, b.stamp_ns) for a, b in got] == [(1, 1), (2, 2), (3, 3)]


def test_the_nearest_within_the_slop_is_taken_once():
    got = outputs(OURS, near, [(0, 10), (0, 12), (1, 11), (1, 12), (1, 30), (0, 40)], 2)
    assert [(a.stamp_ns, b.stamp_ns) for a, b in got] == [(10, 11), (12, 12)]


@settings(max_examples=300)
@given(
    st.integers(2, 3).flatmap(
        lambda inputs: st.tuples(
            st.just(inputs),
            st.lists(st.tuples(st.integers(0, inputs - 1), st.integers(1, 25)), max_size=60),
        )
    ),
    st.sampled_from((exact, near)),
)
def test_outputs_equal_those_of_the_released_package(case, make):
    inputs, arrivals = case
    released = pytest.importorskip('message_filters')
    if not hasattr(released, 'Cache'):
        pytest.skip('the released message_filters is not installed')
    ours, theirs = (outputs(each, make, arrivals, inputs) for each in (OURS, released))
    assert ours == theirs
