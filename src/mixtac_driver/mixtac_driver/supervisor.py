# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Keeps a camera streaming: opens it, hands on what it sees, opens it again when it dies."""

from __future__ import annotations

import threading
import time
from enum import Enum
from typing import TYPE_CHECKING

from mixtac_events.errors import MixtacError

if TYPE_CHECKING:
    from collections.abc import Callable

    from mixtac_driver.camera import Davis346
    from mixtac_driver.stream import CameraBatch

FIRST_PAUSE_S = 0.5
LONGEST_PAUSE_S = 5.0
STOP_TIMEOUT_S = 8.0


class State(Enum):
    """What the supervisor is doing."""

    CONNECTING = 'connecting'
    STREAMING = 'streaming'
    WAITING = 'waiting to reconnect'
    STOPPED = 'stopped'


class Supervisor:
    """Runs a camera in a thread of its own until stopped.

    Args:
        camera: The camera; may be open already.
        on_start: Called in the thread whenever a stream begins, before its first batch.
        on_batch: Called in the thread with everything the camera sees.
        on_error: Called in the thread with one line when the camera could not be opened or its
            stream died; not again for the same line until a stream was up in between.
        first_pause_s: Pause before opening it again [s]; doubles up to LONGEST_PAUSE_S, and is as
            at first again once a stream has lasted longer than that.

    Attributes:
        state: What it is doing.
        error: Why there is no stream, empty while there is one.
        failures: Times that opening or streaming ended with an error.
    """

    def __init__(
        self,
        camera: Davis346,
        *,
        on_start: Callable[[], None],
        on_batch: Callable[[CameraBatch], None],
        on_error: Callable[[str], None],
        first_pause_s: float = FIRST_PAUSE_S,
    ) -> None:
        self.state = State.CONNECTING
        self.error = ''
        self.failures = 0
        self._camera = camera
        self._on_start, self._on_batch, self._on_error = on_start, on_batch, on_error
        self._first_pause_s = first_pause_s
        self._pause_s = first_pause_s
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name='davis-decode', daemon=True)

    def start(self) -> None:
        """Begin."""
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
        while not self._stopping.is_set():
            self.state, began_s = State.CONNECTING, time.monotonic()
            try:
                self._stream()
            except MixtacError as error:
                self._fail(str(error))
            except Exception as error:  # noqa: BLE001 - a dead thread would look like a quiet scene
                self._fail(f'defect in the driver: {error!r}')
            finally:
                self._camera.close()
            self.state = State.WAITING
            if time.monotonic() - began_s > LONGEST_PAUSE_S:
                self._pause_s = self._first_pause_s
            self._stopping.wait(self._pause_s)
            self._pause_s = min(2 * self._pause_s, LONGEST_PAUSE_S)
        self.state = State.STOPPED

    def _stream(self) -> None:
        if not self._camera.is_open:
            self._camera.open()
        self._camera.start()
        self._on_start()
        for batch in self._camera.batches():
            self.state, self.error = State.STREAMING, ''
            self._on_batch(batch)

    def _fail(self, line: str) -> None:
        self.failures += 1
        if line != self.error:
            self.error = line
            self._on_error(line)
