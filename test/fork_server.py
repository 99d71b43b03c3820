# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Processes of nodes under test, forked from a server that has imported their modules before.

Imports and compiled code cost a node 1 to 3 s of processor time, more than most tests need beside.
A forked node runs a function of its module, usually `main`, as its executable does, to the end of
the interpreter. The server itself never initialises ROS, and starts no thread.

Run as a script, this is the server.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import itertools
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from functools import partial
from pathlib import Path
from typing import Any

LARGEST_REQUEST = 1 << 20
WARM_UPS = ('mixtac_core.events.codec', 'mixtac_driver.pixels')
"""Modules that load compiled code or libraries on demand, by their function `warm_up`."""


class NodeProcess:
    """A node in a process of its own. Its output goes to files: it never waits for a reader.

    Args:
        server: The server that forks it.
        module: Module of the node, for example `mixtac_fger.fger_node`.
        arguments: Its command line.

    Attributes:
        pid: Process id.
        returncode: Exit status, or minus the signal that ended it; None while it runs.
    """

    def __init__(self, server: ForkServer, module: str, *arguments: str) -> None:
        self._server = server
        self._outputs = [tempfile.TemporaryFile() for _ in range(2)]  # noqa: SIM115
        self.returncode: int | None = None
        node = {'argv': [module, *arguments], 'cwd': str(Path.cwd()), 'env': dict(os.environ)}
        self.pid: int = server.ask(node, [each.fileno() for each in self._outputs])

    @property
    def stdout(self) -> str:
        """What it has written to its standard output so far."""
        return _text(self._outputs[0].fileno())

    @property
    def stderr(self) -> str:
        """What it has written to its standard error so far."""
        return _text(self._outputs[1].fileno())

    def poll(self) -> int | None:
        """Return the exit status, None while it runs."""
        if self.returncode is None:
            self.returncode = self._server.ask({'wait for': self.pid})
        return self.returncode

    def wait(self, timeout: float) -> int:
        """Wait until it ends, at most this long [s]; return its exit status.

        Raises:
            subprocess.TimeoutExpired: It still runs.
        """
        deadline = time.monotonic() + timeout
        while self.poll() is None:
            if time.monotonic() > deadline:
                raise subprocess.TimeoutExpired(f'process {self.pid}', timeout)
            time.sleep(0.01)
        return self.returncode  # type: ignore[return-value]

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def end(self, number: int = signal.SIGTERM, timeout: float = 30.0) -> int:
        """Send a signal and wait, then kill it; return its exit status."""
        self.send_signal(number)
        try:
            return self.wait(timeout)
        except subprocess.TimeoutExpired:
            self.send_signal(signal.SIGKILL)
            return self.wait(timeout)


class ForkServer:
    """The test's end of the server. It and all nodes end with the process that made it."""

    def __init__(self) -> None:
        self._lock, self._numbers = threading.Lock(), itertools.count()
        self._channel, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with other:
            self._process = subprocess.Popen(
                # Python 3.12 warns of LTTng's threads.
                [sys.executable, '-W', 'ignore::DeprecationWarning', __file__, str(other.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=[other.fileno()],
            )

    def ask(self, request: dict[str, Any], descriptors: list[int] | None = None) -> Any:
        """Return the server's answer to a request."""
        with self._lock:
            number = next(self._numbers)
            message = json.dumps([number, request]).encode()
            socket.send_fds(self._channel, [message], descriptors or [])
            while True:
                answer = self._channel.recv(LARGEST_REQUEST)
                if not answer:
                    raise ConnectionError('the server of node processes ended')
                # A test that ran out of time may have left an answer behind.
                found, value = json.loads(answer)
                if found == number:
                    return value

    def close(self) -> None:
        """End the server, which ends the nodes that still run."""
        self._channel.close()
        self._process.wait(30)


def _text(descriptor: int) -> str:
    return os.pread(descriptor, os.fstat(descriptor).st_size, 0).decode(errors='replace')


def load(module: str) -> None:
    """Import what a module imports, and load compiled code."""
    # Where that fails, the node says why.
    with contextlib.suppress(Exception):
        importlib.import_module(module)
        for name in WARM_UPS:
            if name in sys.modules:
                sys.modules[name].warm_up()
    # The module itself is imported anew by each node.
    sys.modules.pop(module, None)
    # A collection in a forked process would copy every object.
    gc.collect()
    gc.freeze()


def fork_tracing() -> None:
    """Let LTTng, which rclpy loads, start its threads anew in forked processes.

    Without that a process crashes, now and then, when LTTng cancels them at its end.
    """
    importlib.import_module('rclpy.node')
    signals = ctypes.create_string_buffer(128)  # a sigset_t
    loaded = {
        word for word in Path('/proc/self/maps').read_text().split() if 'liblttng-ust' in word
    }
    for library in map(ctypes.CDLL, loaded):
        # The longer names since LTTng 2.13.
        prefix = 'lttng_ust' if hasattr(library, 'lttng_ust_before_fork') else 'ust'
        if hasattr(library, f'{prefix}_before_fork'):
            before, parent, child = (
                partial(getattr(library, f'{prefix}_{name}'), signals)
                for name in ('before_fork', 'after_fork_parent', 'after_fork_child')
            )
            os.register_at_fork(before=before, after_in_parent=parent, after_in_child=child)
            return


def serve(channel: socket.socket) -> tuple[dict[str, Any], list[int]] | None:
    """Answer requests until the other end is closed.

    Returns:
        In a process that is forked for a node: the request, and the files for its output. In the
        server, at its end: None.
    """
    loaded, running = set(), set()
    while True:
        message, descriptors, _, _ = socket.recv_fds(channel, LARGEST_REQUEST, 2)
        if not message:
            for pid in running:
                os.kill(pid, signal.SIGTERM)
            return None
        number, request = json.loads(message)
        if 'wait for' in request:
            pid, status = os.waitpid(request['wait for'], os.WNOHANG)
            running.discard(pid)
            answer = os.waitstatus_to_exitcode(status) if pid else None
        else:
            module = request['argv'][0]
            if module not in loaded:
                load(module)
                loaded.add(module)
            answer = os.fork()
            if answer == 0:
                return request, descriptors
            running.add(answer)
            for each in descriptors:
                os.close(each)
        channel.send(json.dumps([number, answer]).encode())


def main() -> None:
    """Run the server, and the nodes that it forks."""
    # Ctrl-C in a terminal reaches the server as well; it ends with the tests.
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    fork_tracing()
    with socket.socket(fileno=int(sys.argv[1])) as channel:
        node = serve(channel)
    if node is None:
        return
    request, descriptors = node
    for standard, descriptor in enumerate(descriptors, 1):
        os.dup2(descriptor, standard)
        os.close(descriptor)
    os.chdir(request['cwd'])
    os.environ.clear()
    os.environ.update(request['env'])
    added = [each for each in os.environ.get('PYTHONPATH', '').split(os.pathsep) if each]
    sys.path[:1] = [request['cwd'], *added]
    sys.argv = request['argv']
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    sys.exit(importlib.import_module(sys.argv[0]).main())


if __name__ == '__main__':
    main()
