# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The three ways to read the latest value of a stream."""

from __future__ import annotations

import threading

import pytest

from mixtac.latest import (
    Latest,
    NoReadingError,
    NotOpenError,
    ReadTimeoutError,
    StaleReadingError,
)


class Source:
    """Fails once it is closed."""

    open = True

    def check(self) -> None:
        if not self.open:
            raise NotOpenError('closed')


@pytest.fixture
def source() -> Source:
    return Source()


@pytest.fixture
def latest(source) -> Latest[int]:
    return Latest('number', source.check, lambda: 'nobody puts any')


def test_read_waits_for_a_value_newer_than_the_call(latest):
    latest.put(1)
    timer = threading.Timer(0.05, latest.put, [2])
    timer.start()
    assert latest.read() == 2
    timer.join()
    with pytest.raises(ReadTimeoutError):
        latest.read(timeout_ms=1)


def test_async_read_returns_each_value_once_and_the_newest_first(latest):
    latest.put(1)
    latest.put(2)
    assert latest.async_read() == 2
    with pytest.raises(TimeoutError):
        latest.async_read(timeout_ms=1)
    latest.put(3)
    assert latest.async_read() == 3


def test_the_latest_is_returned_again_until_it_is_too_old(latest):
    with pytest.raises(NoReadingError):
        latest.read_latest()
    latest.put(1)
    assert latest.read_latest(max_age_ms=1e6) == latest.read_latest(max_age_ms=1e6) == 1
    with pytest.raises(StaleReadingError):
        latest.read_latest(max_age_ms=0)


def test_another_session_begins_without_a_value(latest):
    latest.put(1)
    latest.clear()
    with pytest.raises(NoReadingError):
        latest.read_latest()
    with pytest.raises(ReadTimeoutError):
        latest.async_read(10)
    latest.put(2)
    assert latest.async_read(10) == 2


def test_a_source_that_ends_ends_the_waiting(latest, source):
    timer = threading.Timer(0.05, setattr, [source, 'open', False])
    timer.start()
    with pytest.raises(NotOpenError):
        latest.read()
    with pytest.raises(NotOpenError):
        latest.read_latest()
