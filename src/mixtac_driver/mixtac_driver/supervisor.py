# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Keeps a source streaming: opens it, passes its batches on, reopens it when the stream fails."""

from __future__ import annotations

import threading
import time
from collections import Counter
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from mixtac_driver.errors import DriverError, EndOfStream
from mixtac_events.errors import MixtacError
from mixtac_node.parameters import parameter
from mixtac_recordings.recording import RecordingError

if TYPE_CHECKING:
    from collections.abc import Callable

    from mixtac_driver.camera import CameraBatch
    from mixtac_driver.source import Source


class RecoveryPolicy(str, Enum):
    """What a failure leads to.

    Attributes:
        RECONNECT: Open the camera again, with growing pauses, until it is back.
        FAIL_STOP: End with the reason; a camera that was never there is still waited for.
    """

    RECONNECT = 'reconnect'
    FAIL_STOP = 'fail_stop'


@dataclass(frozen=True, slots=True)
class RecoverySettings:
    """How failures are dealt with.

    Attributes:
        policy: What a failure leads to.
        first_pause_s: Pause before the first attempt to open the camera again [s].
        longest_pause_s: Longest pause [s]; each is twice as long as the one before.
        give_up_after_s: Time without a stream [s] after which reconnecting ends; 0 never ends.
    """

    policy: RecoveryPolicy = RecoveryPolicy.RECONNECT
    first_pause_s: float = 0.05
    longest_pause_s: float = 0.5
    give_up_after_s: float = 0.0

    def gives_up(self, seconds: float) -> bool:
        """Return whether so many seconds without a stream are too many."""
        return 0 < self.give_up_after_s <= seconds


class Backoff:
    """Pauses that double up to a bound.

    Args:
        first_s: First pause [s].
        longest_s: Longest pause [s].
    """

    def __init__(self, first_s: float, longest_s: float) -> None:
        self._first_s = min(first_s, longest_s)
        self._longest_s = longest_s
        self._next_s = self._first_s

    def next(self) -> float:
        """Return the next pause [s]."""
        pause_s = self._next_s
        self._next_s = min(2 * pause_s, self._longest_s)
        return pause_s

    def reset(self) -> None:
        """Begin with the first pause again."""
        self._next_s = self._first_s


@dataclass(frozen=True)
class RecoveryParameters:
    """Reconnect or end, and how patiently."""

    recovery_policy: str = parameter(
        RecoveryPolicy.RECONNECT.value,
        'What a failure of the camera leads to: reconnect opens it again until it is back; '
        'fail_stop ends the driver with the reason and exit status 1',
        choices=tuple(policy.value for policy in RecoveryPolicy),
        read_only=True,
    )
    recovery_first_pause: float = parameter(
        0.05,
        'Pause before the first attempt to reconnect',
        unit='s',
        minimum=0.01,
        maximum=60.0,
        read_only=True,
    )
    recovery_longest_pause: float = parameter(
        0.5,
        'Longest pause between attempts; each is twice as long as the one before. A camera that is '
        'plugged in ends the pause',
        unit='s',
        minimum=0.01,
        maximum=600.0,
        read_only=True,
    )
    recovery_give_up_after: float = parameter(
        0.0,
        'Time without a stream after which the driver ends as under fail_stop; 0 never',
        unit='s',
        minimum=0.0,
        maximum=86_400.0,
        read_only=True,
    )


def recovery_settings(p: RecoveryParameters) -> RecoverySettings:
    """Return what the parameters ask for."""
    return RecoverySettings(
        policy=RecoveryPolicy(p.recovery_policy),
        first_pause_s=p.recovery_first_pause,
        longest_pause_s=p.recovery_longest_pause,
        give_up_after_s=p.recovery_give_up_after,
    )


STOP_TIMEOUT_S = 8.0
WATCH_S = 0.2
"""How often a pause looks whether a camera was plugged in [s]."""


class State(Enum):
    """What the supervisor is doing."""

    CONNECTING = 'connecting'
    STREAMING = 'streaming'
    WAITING = 'waiting to reconnect'
    STOPPED = 'stopped'
    ENDED = 'ended'
    FAILED = 'failed'


class Supervisor:
    """Runs a source in a thread of its own until it is stopped, ends, or is given up.

    Args:
        camera: The source; may be open already.
        on_start: Called in the thread whenever a stream begins, before its first batch.
        on_batch: Called in the thread with everything the camera sees.
        on_error: Called in the thread with one line when the camera could not be opened or its
            stream died; once for each kind of error until a stream was up in between.
        recovery: What a failure leads to.

    Attributes:
        state: What it is doing.
        error: Why there is no stream, empty while there is one.
        failures: Times that opening or streaming ended with an error.
        failures_by_kind: The same by the name of the error.
        reconnects: Times that a stream came back after one had died.
        outage_s: How long the latest of these took from the last batch to the next [s].
        finished: Set when the thread ends by itself or is stopped.
        failure: What ended it in `State.FAILED`, else None.
    """

    def __init__(
        self,
        camera: Source,
        *,
        on_start: Callable[[], None],
        on_batch: Callable[[CameraBatch], None],
        on_error: Callable[[str], None],
        recovery: RecoverySettings | None = None,
    ) -> None:
        self.state = State.CONNECTING
        self.error = ''
        self.failures = 0
        self.failures_by_kind: Counter[str] = Counter()
        self.reconnects = 0
        self.outage_s = 0.0
        self.finished = threading.Event()
        self.failure: MixtacError | None = None
        self._camera = camera
        self._on_start, self._on_batch, self._on_error = on_start, on_batch, on_error
        self._recovery = recovery or RecoverySettings()
        self._backoff = Backoff(self._recovery.first_pause_s, self._recovery.longest_pause_s)
        self._told: set[type[MixtacError]] = set()
        self._was_open = camera.is_open
        self._has_streamed = False
        self._heard_s = time.monotonic()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name='davis-decode', daemon=True)

    @property
    def quiet_s(self) -> float:
        """Time since the last batch, or since construction [s]; a stream has 30 a second."""
        return time.monotonic() - self._heard_s

    def start(self) -> None:
        """Begin."""
        self._heard_s = time.monotonic()
        self._thread.start()

    def stop(self) -> bool:
        """Stop the stream, close the camera and end the thread.

        Returns:
            False where the thread did not end in time; it cannot keep the process alive.
        """
        self._stopping.set()
        deadline_s = time.monotonic() + STOP_TIMEOUT_S
        while self._thread.is_alive() and time.monotonic() < deadline_s:
            # Again and again, because a stream that is just starting does not see the first.
            self._camera.request_stop()
            self._thread.join(0.05)
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                self._stream_until_failure()
                self._check_patience()
                self._pause()
            self.state = State.STOPPED
        except EndOfStream:
            self.state, self.error = State.ENDED, ''
        except MixtacError as error:
            if self._stopping.is_set():
                self.state = State.STOPPED
            else:
                self.failure, self.state = error, State.FAILED
        except Exception as error:  # noqa: BLE001 - as above, and closing failed as well
            self.error = f'defect in the driver: {error!r}'
            self.failure, self.state = DriverError(self.error), State.FAILED
        finally:
            self.finished.set()

    def _stream_until_failure(self) -> None:
        """Open and stream.

        Raises:
            EndOfStream: The source has no more data.
            MixtacError: The policy says that a failure is the end.
        """
        self.state = State.CONNECTING
        try:
            self._stream()
        except EndOfStream:
            raise
        except MixtacError as error:
            self._fail(error)
        except Exception as error:  # noqa: BLE001 - a dead thread would look like a quiet scene
            self._fail(DriverError(f'defect in the driver: {error!r}'))
        finally:
            self._camera.close()

    def _stream(self) -> None:
        if not self._camera.is_open:
            self._camera.open()
        self._was_open = True
        self._camera.start()
        began_s = time.monotonic()
        self._on_start()
        for batch in self._camera.batches():
            self._note_batch(began_s)
            self._on_batch(batch)

    def _note_batch(self, began_s: float) -> None:
        now_s = time.monotonic()
        if self.state is not State.STREAMING:
            if self._has_streamed:
                self.reconnects += 1
                self.outage_s = now_s - self._heard_s
            self._has_streamed = True
            self.state, self.error = State.STREAMING, ''
            self._told.clear()
        # A stream that dies at once again and again must not be opened without pause.
        if now_s - began_s > self._recovery.longest_pause_s:
            self._backoff.reset()
        self._heard_s = now_s

    def _fail(self, error: MixtacError) -> None:
        self.failures += 1
        self.failures_by_kind[type(error).__name__] += 1
        self.error = str(error)
        if type(error) not in self._told:
            self._told.add(type(error))
            self._on_error(self.error)
        fail_stop = self._recovery.policy is RecoveryPolicy.FAIL_STOP and self._was_open
        if fail_stop or isinstance(error, RecordingError):
            raise error

    def _check_patience(self) -> None:
        if self._recovery.gives_up(self.quiet_s) and not self._stopping.is_set():
            raise DriverError(f'no stream for {self.quiet_s:.0f} s, giving up: {self.error}')

    def _pause(self) -> None:
        """Wait for the pause to pass, or for a camera to be plugged in."""
        if self._stopping.is_set():
            return
        self.state = State.WAITING
        before = self._camera.attached()
        until_s = time.monotonic() + self._backoff.next()
        while (left_s := until_s - time.monotonic()) > 0:
            if self._stopping.wait(min(left_s, WATCH_S)):
                return
            now = self._camera.attached()
            if now - before:
                self._backoff.reset()
                return
            before = now
