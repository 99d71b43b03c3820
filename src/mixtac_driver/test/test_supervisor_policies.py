# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the supervisor does under each policy, on a source that follows a script."""

from __future__ import annotations

import threading
import time
from itertools import pairwise
from types import SimpleNamespace

import pytest

from mixtac_core.recordings.recording import RecordingError
from mixtac_driver.errors import EndOfStream, HungReadError, NoCameraError, StreamError
from mixtac_driver.parameters import DriverParameters, RecoveryPolicy
from mixtac_driver.supervisor import State, Supervisor


@pytest.fixture(autouse=True)
def reports_at_once(monkeypatch):
    monkeypatch.setattr('mixtac_driver.supervisor.REPORT_AFTER_S', 0.0)
    monkeypatch.setattr('mixtac_driver.supervisor.REPORT_ABSENCE_AFTER_S', 0.0)


NOBODY = frozenset()
ONE, TWO = frozenset({(1, 1)}), frozenset({(1, 2)})


class Script:
    """A source: each opening takes the next entry, which is what goes wrong where, or nothing."""

    def __init__(self, *entries, attached=()):
        self.entries = list(entries)
        self.attachments = list(attached)
        self.is_open = False
        self.openings = 0
        self.opened_s = []
        self.stopping = threading.Event()

    def status(self):
        return SimpleNamespace(is_open=self.is_open)

    def open(self):
        self.openings += 1
        self.opened_s.append(time.monotonic())
        self.stopping.clear()
        self.entry = self.entries.pop(0) if self.entries else None
        self._raise_in('open')
        self.is_open = True

    def start(self):
        self._raise_in('start')

    def batches(self):
        yield 'batch'
        self._raise_in('batches')
        self.stopping.wait(10)

    def request_stop(self):
        self.stopping.set()

    def close(self):
        self.is_open = False
        if self.entry is not None and self.entry[0] == 'close':
            raise self.entry[1]

    def attached(self):
        return self.attachments.pop(0) if self.attachments else NOBODY

    def _raise_in(self, place):
        if self.entry is not None and self.entry[0] == place:
            raise self.entry[1]


class Watch:
    """A supervisor on a script, and what it called back."""

    def __init__(self, script, on_batch=None, on_error=None, **recovery):
        self.starts, self.batches, self.errors = [], [], []
        self.streaming = threading.Semaphore(0)
        settings = {'recovery_first_pause': 0.001, 'recovery_longest_pause': 0.002, **recovery}
        self.supervisor = Supervisor(
            script,
            DriverParameters(**settings),
            on_start=lambda: self.starts.append(1),
            on_batch=on_batch or self._on_batch,
            on_error=on_error or self.errors.append,
        )
        self.supervisor.start()

    def _on_batch(self, batch):
        self.batches.append(batch)
        self.streaming.release()

    def wait_for_stream(self, number=1):
        for _ in range(number):
            assert self.streaming.acquire(timeout=5)

    def wait_for_end(self):
        assert self.supervisor.finished.wait(5)
        assert self.supervisor.stop()
        return self.supervisor


def died():
    return 'batches', StreamError('died')


def test_reconnecting_goes_on_through_every_kind_of_failure():
    script = Script(
        ('open', NoCameraError('gone')),
        ('open', NoCameraError('gone')),
        ('start', StreamError('no start')),
        died(),
        ('batches', KeyError('defect')),
    )
    watch = Watch(script)
    watch.wait_for_stream(3)
    supervisor = watch.supervisor
    assert supervisor.state is State.STREAMING
    assert watch.errors == ['gone', 'no start', 'died', "defect in the driver: KeyError('defect')"]
    assert supervisor.failures == 5
    kinds = {'NoCameraError': 2, 'StreamError': 2, 'DriverError': 1}
    assert supervisor.failures_by_kind == kinds
    assert supervisor.reconnects == 2
    assert not supervisor.finished.is_set()
    assert supervisor.stop()
    assert (supervisor.state, supervisor.failure) == (State.STOPPED, None)
    assert supervisor.finished.is_set()


def test_what_changes_with_every_attempt_is_told_once_and_shown_always():
    entries = [('open', NoCameraError(f'attempt {number}')) for number in range(20)]
    watch = Watch(Script(*entries, ('open', StreamError('other'))))
    watch.wait_for_stream()
    assert watch.errors == ['attempt 0', 'other']
    assert watch.supervisor.failures == 21
    assert watch.supervisor.stop()


@pytest.mark.parametrize('entry', [('start', StreamError('died')), died()])
def test_fail_stop_ends_at_the_first_failure_with_the_reason(entry):
    script = Script(entry)
    supervisor = Watch(script, recovery_policy='fail_stop').wait_for_end()
    assert (supervisor.state, str(supervisor.failure)) == (State.FAILED, 'died')
    assert script.openings == 1
    assert not script.is_open


def test_fail_stop_waits_for_a_camera_that_was_never_there_but_not_for_one_that_left():
    script = Script(('open', NoCameraError('late')), ('open', NoCameraError('late')), died())
    supervisor = Watch(script, recovery_policy='fail_stop').wait_for_end()
    assert str(supervisor.failure) == 'died'
    assert script.openings == 3


def test_patience_has_an_end_where_one_is_set():
    script = Script(*[('open', NoCameraError('gone'))] * 10_000)
    supervisor = Watch(script, recovery_give_up_after=0.05).wait_for_end()
    assert supervisor.state is State.FAILED
    assert 'giving up: gone' in str(supervisor.failure)


@pytest.mark.parametrize('policy', RecoveryPolicy)
def test_end_of_a_recording_is_no_failure(policy):
    script = Script(('batches', EndOfStream('over')))
    watch = Watch(script, recovery_policy=policy.value)
    supervisor = watch.wait_for_end()
    assert (supervisor.state, supervisor.error, supervisor.failure) == (State.ENDED, '', None)
    assert (script.openings, supervisor.failures, watch.errors) == (1, 0, [])
    assert not script.is_open


@pytest.mark.parametrize('kind', [RecordingError, HungReadError])
def test_what_a_second_attempt_cannot_mend_is_not_tried_again(kind):
    script = Script(('open', kind('damaged')))
    supervisor = Watch(script).wait_for_end()
    assert (supervisor.state, str(supervisor.failure)) == (State.FAILED, 'damaged')
    assert script.openings == 1


def test_pauses_double_up_to_a_bound():
    script = Script(*[('open', NoCameraError('gone'))] * 4)
    watch = Watch(script, recovery_first_pause=0.02, recovery_longest_pause=0.05)
    watch.wait_for_stream()
    pauses = [after - before for before, after in pairwise(script.opened_s)]
    assert all(
        pause >= least for pause, least in zip(pauses, (0.02, 0.04, 0.05, 0.05), strict=True)
    )
    assert watch.supervisor.stop()


@pytest.mark.parametrize(
    'attached', [[NOBODY, NOBODY, ONE], [ONE, TWO], [ONE, NOBODY, ONE], [ONE, ONE | TWO]]
)
def test_plugging_in_ends_a_long_pause(monkeypatch, attached):
    monkeypatch.setattr('mixtac_driver.supervisor.WATCH_S', 0.005)
    script = Script(('open', NoCameraError('gone')), attached=attached)
    watch = Watch(script, recovery_first_pause=1000.0, recovery_longest_pause=1000.0)
    watch.wait_for_stream()
    assert script.openings == 2
    assert watch.supervisor.stop()


def test_unplugging_and_nothing_new_do_not_end_a_pause(monkeypatch):
    monkeypatch.setattr('mixtac_driver.supervisor.WATCH_S', 0.001)
    attached = [ONE | TWO, ONE, ONE, NOBODY, NOBODY]
    script = Script(('open', NoCameraError('gone')), attached=attached)
    watch = Watch(script, recovery_first_pause=1000.0, recovery_longest_pause=1000.0)
    while script.attachments:
        time.sleep(0.001)
    assert script.openings == 1
    assert watch.supervisor.state is State.WAITING
    assert watch.supervisor.stop()


def test_close_that_fails_ends_the_supervisor_and_is_told():
    script = Script(('close', KeyError('defect')))
    watch = Watch(script)
    watch.wait_for_stream()
    script.request_stop()
    supervisor = watch.wait_for_end()
    assert supervisor.state is State.FAILED
    assert 'defect' in str(supervisor.failure)


def test_callback_that_fails_while_it_is_told_of_a_failure_does_not_end_in_silence():
    def broken(_line):
        raise ZeroDivisionError

    supervisor = Watch(Script(died()), on_error=broken).wait_for_end()
    assert supervisor.state is State.FAILED
    assert 'ZeroDivisionError' in str(supervisor.failure)


def test_consumer_that_hangs_can_be_seen():
    release = threading.Event()
    watch = Watch(Script(), on_batch=lambda _batch: release.wait(10))
    while watch.supervisor.state is not State.STREAMING:
        time.sleep(0.001)
    before = watch.supervisor.quiet_s
    while watch.supervisor.quiet_s <= before:
        time.sleep(0.001)
    release.set()
    assert watch.supervisor.stop()
