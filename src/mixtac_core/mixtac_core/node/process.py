# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Child processes: environment, start, supervision and end.

The module also controls garbage collection, priority and compilation of real-time processes.
"""

from __future__ import annotations

import contextlib
import faulthandler
import fcntl
import gc
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from types import FrameType
from typing import IO, Any, cast

from mixtac_core.events.errors import ERROR, MixtacError
from mixtac_core.node.files import share


class GraphError(MixtacError):
    """A node that did not start, ended, or could not be configured."""


FASTDDS_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
"""Fast DDS 2 (ROS 2 Jazzy) reads the first, Fast DDS 3 the second."""
_ON_THIS_MACHINE = {'LOCALHOST', 'OFF'}


def freeze_loaded() -> None:
    """Take all present objects out of garbage collection: a full pass takes 0.1 s."""
    gc.collect()
    gc.freeze()


def lower_priority(niceness: int) -> None:
    """Set the niceness of the calling thread, where the system has one for threads."""
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), niceness)


@contextlib.contextmanager
def compiling(kernels: str, say: Callable[[], None] = lambda: None) -> Iterator[None]:
    """Load compiled kernels, or compile them while no other process of the user compiles the same.

    Processes that write the same kernels into numba's cache at once mix their signatures up; a
    later start then calls one with the arguments of another.

    Args:
        kernels: Name of what is compiled within the context; kernels that two contexts share
            need one name for both.
        say: Called once, before the first compilation, if there is any.
    """
    from numba.core import event

    class OnCompile(event.Listener):  # type: ignore[misc]
        begun = False

        def on_start(self, _event: object) -> None:
            if not self.begun:
                self.begun = True
                # It may take longer than `STUCK_S`.
                faulthandler.cancel_dump_traceback_later()
                say()
                fcntl.flock(lock, fcntl.LOCK_EX)

        def on_end(self, _event: object) -> None:
            pass

    folder = Path(tempfile.gettempdir()) / f'mixtac-kernels-{os.getuid()}'
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.lstat().st_uid != os.getuid():
        raise GraphError(f'{folder} belongs to another user', remedy='set TMPDIR to another folder')
    # Each copy of the sources has compiled kernels of its own.
    path = folder / f'{__file__[-100:]}-{kernels}'.replace('/', '.')
    with path.open('w') as lock, event.install_listener('numba:compile', OnCompile()):
        yield


def profile_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the variables that select our Fast DDS profile; none if the user has a profile.

    Args:
        environment: Environment of the nodes; `ROS_AUTOMATIC_DISCOVERY_RANGE` decides between
            loopback and all interfaces.
    """
    folder = share('mixtac_bringup') / 'config' / 'fastdds'
    # A shell may have one of ours from before the range was changed.
    ours = {each.resolve() for each in folder.glob('*.xml')}
    set_ = filter(None, map(environment.get, FASTDDS_VARIABLES))
    if any(Path(each).resolve() not in ours for each in set_):
        return {}
    local = environment.get('ROS_AUTOMATIC_DISCOVERY_RANGE', '') in _ON_THIS_MACHINE
    return dict.fromkeys(FASTDDS_VARIABLES, str(folder / ('local.xml' if local else 'network.xml')))


STOP_GRACE_S = 20.0
"""From SIGTERM to SIGKILL [s]: on a busy host a last picture takes ten."""
_ENDING = (signal.SIGTERM, signal.SIGHUP)
STUCK_S = 30.0
"""Time after which a process ends whose callback, or middleware, does not return [s]."""
_STUCK = 'Timeout ('
_LOGGED = re.compile(r'^\[(ERROR|FATAL)\] \[[^]]*\] \[[^]]*\]: (?P<text>.*)')


def fatal_text(line: str) -> str:
    """Return why a node ends, from a line of its stderr; empty for other lines."""
    if line.startswith(_STUCK):
        return f'nothing returned to the executor for {STUCK_S:g} s; a traceback shows what ran'
    return line.removeprefix(ERROR).strip() if line.startswith(ERROR) else ''


class ProcessGroup:
    """The processes of a graph; all end with this process.

    Leaving the `with` block ends them. Inside it, SIGTERM and SIGHUP raise SystemExit (in the main
    thread only, where Python handles signals). If this process is killed, the kernel sends them
    SIGTERM, provided that `setpriv` of util-linux is installed.

    Args:
        log_dir: Folder for one log file per process, or None to forward their output to stderr.
        env: Environment of the processes; None for this process's own.
    """

    def __init__(self, log_dir: Path | None = None, env: dict[str, str] | None = None) -> None:
        self._log_dir = log_dir
        self._env = env
        self._processes: dict[str, subprocess.Popen[str]] = {}
        self._readers: dict[str, threading.Thread] = {}
        self._errors: dict[str, str] = {}
        self._handlers: dict[int, Any] = {}

    def __enter__(self) -> ProcessGroup:
        """Return the group."""
        if threading.current_thread() is threading.main_thread():
            self._handlers = {number: signal.signal(number, _leave) for number in _ENDING}
        return self

    def __exit__(self, *_: object) -> None:
        """End all processes."""
        self.stop()
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def start(self, name: str, command: list[str]) -> None:
        """Start a process under a name.

        It gets its own session, so that Ctrl-C in the terminal reaches this process only, which
        then ends the nodes in order.
        """
        sink: IO[str] = sys.stderr
        if self._log_dir is not None:
            self._log_dir.mkdir(parents=True, exist_ok=True)
            sink = (self._log_dir / f'{name}.log').open('w')
        self._processes[name] = process = subprocess.Popen(
            ending_with_parent(command),
            env=self._env,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors='replace',
            start_new_session=True,
        )
        forward = partial(self._forward, name, cast('IO[str]', process.stdout), sink)
        self._readers[name] = threading.Thread(target=forward, daemon=True)
        self._readers[name].start()

    def _forward(self, name: str, lines: Iterable[str], sink: IO[str]) -> None:
        """Forward the output of a process and remember its last error.

        On stderr the error line with which it ends is left out if `check` reports it.
        """
        shared = sink is sys.stderr
        for line in lines:
            fatal, logged = fatal_text(line), _LOGGED.match(line)
            if fatal or logged:
                self._errors[name] = fatal or logged['text'].strip()  # type: ignore[index]
            if not (fatal and shared and name in self._processes):
                print(f'[{name}] {line}' if shared else line, end='', file=sink, flush=True)
        if not shared:
            sink.close()

    def check(self) -> None:
        """Raise if a process has ended.

        Raises:
            GraphError: Names the process and its last error.
        """
        for name, process in self._processes.items():
            code = process.poll()
            if code is not None:
                self._readers[name].join(1.0)
                if code < 0:
                    # What it logged before has nothing to do with it.
                    raise GraphError(f'{name} was ended by {signal.Signals(-code).name}')
                how = f'{name} ended with status {code}'
                raise GraphError(': '.join(filter(None, (how, self._errors.get(name)))))

    def pid(self, name: str) -> int:
        """Return the id of a process."""
        return self._processes[name].pid

    def stop(self, name: str | None = None) -> dict[str, int]:
        """End one process or all, newest first: SIGTERM, then SIGKILL after a grace time.

        Not SIGINT, to which a Python process that is still importing responds with a traceback.

        Args:
            name: Name of the process; one that does not run is ignored. None: all.

        Returns:
            Exit status by name.
        """
        chosen = [each for each in reversed(self._processes) if name in (None, each)]
        ending = {each: self._processes.pop(each) for each in chosen}
        for process in ending.values():
            process.terminate()
        deadline = time.monotonic() + STOP_GRACE_S
        codes = {}
        for each, process in ending.items():
            try:
                process.wait(max(0.1, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
            codes[each] = process.wait()
            self._readers[each].join(1.0)
        return codes


def _leave(number: int, _frame: FrameType | None) -> None:
    raise SystemExit(128 + number)


def ending_with_parent(command: list[str]) -> list[str]:
    """Return a command whose process gets SIGTERM when the thread that started it ends."""
    setpriv = shutil.which('setpriv')
    main = threading.current_thread() is threading.main_thread()
    return [setpriv, '--pdeathsig', 'TERM', '--', *command] if setpriv and main else command
