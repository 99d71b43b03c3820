# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which source a device string names, and what the supervisor does after its failures."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace

import pytest
from davis_fake import FakeBackend, FakeCamera

from mixtac_core.recordings.recording import RecordingError
from mixtac_driver import supervisor as supervisor_module
from mixtac_driver.camera import Davis346
from mixtac_driver.errors import (
    EndOfStream,
    HungReadError,
    NoCameraError,
    StreamError,
    UnknownDeviceError,
)
from mixtac_driver.parameters import DriverParameters
from mixtac_driver.playback import RecordedSource
from mixtac_driver.supervisor import SourceKind, State, Supervisor, make_source, source_kind

NEVER_S = 1000.0
GONE = ('open', NoCameraError('gone'))
DIED = ('batches', StreamError('died'))


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(supervisor_module, 'REPORT_AFTER_S', 0.0)
    monkeypatch.setattr(supervisor_module, 'REPORT_ABSENCE_AFTER_S', 0.0)
    monkeypatch.setattr(supervisor_module, 'FIRST_PAUSE_S', 0.001)
    monkeypatch.setattr(supervisor_module, 'LONGEST_PAUSE_S', 0.002)


class Script:
    """A source: each opening takes the next entry, which is what goes wrong where, or nothing."""

    def __init__(self, *entries):
        self.entries = list(entries)
        self.is_open = False
        self.openings = 0
        self.stopping = threading.Event()

    def status(self):
        return SimpleNamespace(is_open=self.is_open)

    def open(self):
        self.openings += 1
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
        self._raise_in('close')

    def _raise_in(self, place):
        if self.entry is not None and self.entry[0] == place:
            raise self.entry[1]


class Watch:
    """A supervisor on a script, and what it called back."""

    def __init__(self, script, on_batch=None, on_error=None, **settings):
        self.log = []
        self.streaming = threading.Semaphore(0)
        self.supervisor = Supervisor(
            script,
            DriverParameters(**settings),
            on_start=lambda: self.log.append('streaming'),
            on_batch=on_batch or (lambda _batch: self.streaming.release()),
            on_error=on_error or self.log.append,
        )
        self.supervisor.start()

    @property
    def errors(self):
        return [line for line in self.log if line != 'streaming']

    def wait_for_stream(self, number=1):
        for _ in range(number):
            assert self.streaming.acquire(timeout=60)

    def wait_for_end(self):
        assert self.supervisor.finished.wait(60)
        assert self.supervisor.stop()
        return self.supervisor


def test_reconnecting_goes_on_through_every_kind_of_failure():
    defect = ('batches', KeyError('defect'))
    watch = Watch(Script(GONE, GONE, ('start', StreamError('no start')), DIED, defect))
    watch.wait_for_stream(3)
    supervisor = watch.supervisor
    assert (supervisor.state, supervisor.error) == (State.STREAMING, '')
    assert watch.errors == ['gone', 'no start', 'died', "defect in the driver: KeyError('defect')"]
    assert (supervisor.failures_by_kind.total(), supervisor.reconnects) == (5, 2)
    kinds = {'NoCameraError': 2, 'StreamError': 2, 'DriverError': 1}
    assert supervisor.failures_by_kind == kinds
    assert not supervisor.finished.is_set()
    assert supervisor.stop()
    assert (supervisor.state, supervisor.failure) == (State.STOPPED, None)
    assert supervisor.finished.is_set()


def test_an_error_that_changes_with_every_attempt_is_reported_once():
    entries = [('open', NoCameraError(f'attempt {number}')) for number in range(20)]
    watch = Watch(Script(*entries, ('open', StreamError('other'))))
    watch.wait_for_stream()
    assert watch.errors == ['attempt 0', 'other']
    assert watch.supervisor.failures_by_kind.total() == 21
    assert watch.supervisor.stop()


def test_the_last_word_after_an_outage_is_that_the_stream_is_back(monkeypatch):
    monkeypatch.setattr(supervisor_module, 'REPORT_AFTER_S', NEVER_S)
    watch = Watch(Script(DIED))
    watch.wait_for_stream(2)
    assert watch.log == ['streaming', 'died', 'streaming']
    assert watch.supervisor.stop()
    assert watch.log[-1] == 'streaming'


@pytest.mark.parametrize('entries', [[GONE, GONE], [DIED, *[GONE] * 10_000]])
def test_a_late_start_and_an_ordered_end_are_no_failures(monkeypatch, entries):
    monkeypatch.setattr(supervisor_module, 'REPORT_AFTER_S', NEVER_S)
    monkeypatch.setattr(supervisor_module, 'REPORT_ABSENCE_AFTER_S', NEVER_S)
    watch = Watch(Script(*entries))
    watch.wait_for_stream()
    while watch.supervisor.failures_by_kind.total() < 2:
        time.sleep(0.001)
    assert watch.supervisor.stop()
    assert watch.errors == []


def test_patience_has_an_end_where_one_is_set():
    supervisor = Watch(Script(*[GONE] * 10_000), recovery_give_up_after=0.05).wait_for_end()
    assert supervisor.state is State.FAILED
    assert 'gone' in str(supervisor.failure)


def test_end_of_a_recording_is_no_failure():
    script = Script(('batches', EndOfStream('over')))
    watch = Watch(script)
    supervisor = watch.wait_for_end()
    assert (supervisor.state, supervisor.error, supervisor.failure) == (State.ENDED, '', None)
    assert (script.openings, supervisor.failures_by_kind.total(), watch.errors) == (1, 0, [])
    assert not script.is_open


@pytest.mark.parametrize('kind', [RecordingError, HungReadError])
def test_a_source_that_opening_again_cannot_mend_is_not_opened_again(kind):
    script = Script(('open', kind('damaged')))
    supervisor = Watch(script).wait_for_end()
    assert (supervisor.state, supervisor.error) == (State.FAILED, 'damaged')
    assert isinstance(supervisor.failure, kind)
    assert script.openings == 1


@pytest.mark.parametrize('moment_s', [0.0, 0.015, 0.1])
def test_stop_returns_whenever_it_is_called(monkeypatch, moment_s):
    monkeypatch.setattr('mixtac_driver.davis346.writes.BIASES_SETTLE_S', 0.01)
    monkeypatch.setattr('mixtac_driver.davis346.writes.LOGIC_SETTLE_S', 0.01)
    # A busy host may be compiling the decoder.
    monkeypatch.setattr('mixtac_driver.supervisor.STOP_TIMEOUT_S', 120.0)
    fake = FakeCamera()
    watch = Watch(Davis346(backend=FakeBackend(fake)))
    time.sleep(moment_s)
    assert watch.supervisor.stop()
    assert fake.handles == 0


@pytest.mark.parametrize(
    ('device', 'kind'),
    [
        ('davis346', SourceKind.CAMERA),
        ('virtual', SourceKind.SIMULATED),
        ('virtual:/tmp/camera.sock', SourceKind.SIMULATED),
        ('recording.aedat4', SourceKind.RECORDED),
        ('recording.mcap', SourceKind.RECORDED),
        ('data/trial_7', SourceKind.RECORDED),
    ],
)
def test_the_name_of_a_device_or_the_path_of_a_recording(device, kind):
    pytest.importorskip('mixtac_sim.usb.server')
    assert source_kind(device) is kind
    expected = RecordedSource if kind is SourceKind.RECORDED else Davis346
    assert isinstance(make_source(DriverParameters(device=device)), expected)


def test_anything_else_is_unknown():
    with pytest.raises(UnknownDeviceError) as error:
        make_source(DriverParameters(device='nonsense'))
    assert 'nonsense' in str(error.value)
