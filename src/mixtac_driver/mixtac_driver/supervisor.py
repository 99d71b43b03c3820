# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sources of data by device string, and the supervisor that opens one and keeps it streaming."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from mixtac_core.events.errors import MixtacError
from mixtac_core.recordings.recording import AEDAT4_SUFFIX, BAG_SUFFIXES, RecordingError
from mixtac_driver.camera import CameraBatch, Davis346
from mixtac_driver.davis346.control import PixelFilter
from mixtac_driver.device import check_device, is_real
from mixtac_driver.errors import DriverError, EndOfStream, HungReadError, UnknownDeviceError
from mixtac_driver.parameters import DriverParameters

if TYPE_CHECKING:
    from mixtac_driver.playback import RecordedSource

STOP_TIMEOUT_S = 8.0
"""Longest wait for the thread to end [s]."""
FIRST_PAUSE_S = 0.05
"""Pause before the first attempt to reconnect [s]; each pause is twice as long as the previous."""
LONGEST_PAUSE_S = 0.2
"""Longest pause between attempts to reconnect [s]."""
REPORT_AFTER_S = 0.7
"""Delay of reporting a failure [s], longer than signals take to reach all nodes of a launch."""
REPORT_ABSENCE_AFTER_S = 30.0
"""Delay of reporting that a camera was never there [s]: a simulated one may start later."""


Source: TypeAlias = 'Davis346 | RecordedSource'
"""Yields batches; `batches` is for one thread, everything else may be used from others."""


class SourceKind(Enum):
    """Kind of a source; values are shown to users."""

    CAMERA = 'camera'
    SIMULATED = 'simulated camera'
    RECORDED = 'recording'


def source_kind(device: str) -> SourceKind:
    """Return the kind of source that a device string names.

    Raises:
        UnknownDeviceError: It names nothing known.
    """
    if is_real(device):
        return SourceKind.CAMERA
    try:
        check_device(device)
    except UnknownDeviceError as error:
        path = Path(device)
        if path.suffix in (AEDAT4_SUFFIX, *BAG_SUFFIXES) or '/' in device or path.exists():
            return SourceKind.RECORDED
        remedy = f'{error.remedy}, or the path of a recording'
        raise UnknownDeviceError(error.message, remedy=remedy) from error
    return SourceKind.SIMULATED


def make_source(
    parameters: DriverParameters,
    *,
    pixel_filter: PixelFilter = (),
) -> Source:
    """Return the source behind the parameter `device`, not yet open.

    Args:
        parameters: All of them.
        pixel_filter: Pixels whose events a camera drops, most important first.

    Raises:
        UnknownDeviceError: The device string names nothing known.
    """
    if source_kind(parameters.device) is SourceKind.RECORDED:
        # A camera's driver starts without the readers of recordings.
        from mixtac_driver.playback import RecordedSource

        return RecordedSource(parameters)
    return Davis346(parameters, pixel_filter=pixel_filter)


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

    Failures are reported with a delay: an ordered end, in which the camera may go away first, and
    a start in which it comes last are no failures. What is reported last is the present state: an
    outage that ended is reported before the start of the next stream.

    Args:
        source: The source; may be open already. Its `batches` raise EndOfStream at a regular end,
            RecordingError where opening it again does not help, and other errors where the stream
            died.
        parameters: When to give up (`recovery_give_up_after`).
        on_start: Called in the thread whenever a stream starts, before its first batch.
        on_batch: Called in the thread with every batch.
        on_error: Called in the thread with one line when the source could not be opened or its
            stream died; once for each kind of error until a stream was up in between.

    Attributes:
        state: What it is doing.
        error: Why there is no stream, empty while there is one.
        failures_by_kind: Times that opening or streaming ended with an error, by its name.
        reconnects: Times that a stream came back after one had died.
        outage_s: How long the latest of these took from the last batch to the next [s].
        finished: Set when the thread ends by itself or is stopped.
        failure: What ended it in `State.FAILED`, else None.
    """

    def __init__(
        self,
        source: Source,
        parameters: DriverParameters | None = None,
        *,
        on_start: Callable[[], None],
        on_batch: Callable[[CameraBatch], None],
        on_error: Callable[[str], None],
    ) -> None:
        self.state = State.CONNECTING
        self.error = ''
        self.failures_by_kind: Counter[str] = Counter()
        self.reconnects = 0
        self.outage_s = 0.0
        self.finished = threading.Event()
        self.failure: MixtacError | None = None
        self._source = source
        self._p = parameters or DriverParameters()
        self._on_start, self._on_batch, self._on_error = on_start, on_batch, on_error
        self._pause_s = FIRST_PAUSE_S
        # Since the latest stream: the first error of each kind, and how many were reported.
        self._errors: dict[type[MixtacError], str] = {}
        self._reported = 0
        self._report_due_s = 0.0
        self._was_open = source.status().is_open
        self._has_streamed = False
        self._heard_s = time.monotonic()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name='davis-decode', daemon=True)

    @property
    def quiet_s(self) -> float:
        """Time since the last batch, or since construction [s]; a stream has 30 a second."""
        return time.monotonic() - self._heard_s

    def start(self) -> None:
        """Start the thread."""
        self._heard_s = time.monotonic()
        self._thread.start()

    def stop(self) -> bool:
        """Stop the stream, close the source and end the thread.

        Returns:
            False if the thread did not end in time; it cannot keep the process alive.
        """
        self._stopping.set()
        deadline_s = time.monotonic() + STOP_TIMEOUT_S
        while self._thread.is_alive() and time.monotonic() < deadline_s:
            # Repeated, because a stream that is just starting does not see the first request.
            self._source.request_stop()
            self._thread.join(0.05)
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                self._attempt()
                self._pause()
            self.state = State.STOPPED
        except EndOfStream:
            self.state, self.error = State.ENDED, ''
        except Exception as error:  # noqa: BLE001 - a dead thread would look like a quiet scene
            if self._stopping.is_set():
                self.state = State.STOPPED
            else:
                self.failure, self.state = _named(error), State.FAILED
                self.error = str(self.failure)
        finally:
            self.finished.set()

    def _attempt(self) -> None:
        """Open the source and stream until that fails.

        Raises:
            EndOfStream: The source has no more data.
            MixtacError: Opening it again does not help.
        """
        self.state = State.CONNECTING
        try:
            self._stream()
        except (EndOfStream, RecordingError, HungReadError):
            raise
        except Exception as error:  # noqa: BLE001 - it is reported, and the source reopened
            self._note_failure(_named(error))
        finally:
            self._source.close()

    def _stream(self) -> None:
        if not self._source.status().is_open:
            self._source.open()
        self._was_open = True
        self._source.start()
        began_s = time.monotonic()
        for batch in self._source.batches():
            now_s = time.monotonic()
            if self.state is not State.STREAMING:
                self._note_start(now_s)
            # A stream that dies at once again and again must not be opened without pause.
            if now_s - began_s > LONGEST_PAUSE_S:
                self._pause_s = FIRST_PAUSE_S
            self._heard_s = now_s
            self._on_batch(batch)

    def _note_start(self, now_s: float) -> None:
        if self._has_streamed:
            self._report()
        self._on_start()
        if self._has_streamed:
            self.reconnects += 1
            self.outage_s = now_s - self._heard_s
        self._has_streamed = True
        self.state, self.error = State.STREAMING, ''
        self._errors.clear()
        self._reported = 0

    def _note_failure(self, error: MixtacError) -> None:
        self.failures_by_kind[type(error).__name__] += 1
        self.error = str(error)
        if self._reported == len(self._errors):
            delay_s = REPORT_AFTER_S if self._was_open else REPORT_ABSENCE_AFTER_S
            self._report_due_s = time.monotonic() + delay_s
        self._errors.setdefault(type(error), self.error)

    def _report(self) -> None:
        lines = [*self._errors.values()][self._reported :]
        self._reported = len(self._errors)
        if not self._stopping.is_set():
            for line in lines:
                self._on_error(line)

    def _pause(self) -> None:
        """Wait, unless it is time to give up."""
        if self._stopping.is_set():
            return
        quiet_s = self.quiet_s
        if 0 < self._p.recovery_give_up_after <= quiet_s:
            raise DriverError(f'no stream for {quiet_s:.0f} s, giving up: {self.error}')
        self.state = State.WAITING
        if time.monotonic() >= self._report_due_s:
            self._report()
        self._stopping.wait(self._pause_s)
        self._pause_s = min(2 * self._pause_s, LONGEST_PAUSE_S)


def _named(error: Exception) -> MixtacError:
    """Return an error as one that users may see; others are defects."""
    return (
        error if isinstance(error, MixtacError) else DriverError(f'defect in the driver: {error!r}')
    )
