# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Two network namespaces with a bad link between them, made in user space: it needs no netem."""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import heapq
import os
import random
import select
import shutil
import struct
import subprocess
import threading
import time
from dataclasses import dataclass
from pathlib import Path

TUNSETIFF, IFF_TAP, IFF_NO_PI = 0x400454CA, 0x0002, 0x1000
LARGEST = 65_536
MOST_WAITING = 2000
"""Packets that the link holds; more are lost, as in a router."""


@dataclass
class Quality:
    """What the link does.

    Attributes:
        loss: Share of packets that are lost.
        delay_s: Shortest delay [s].
        jitter_s: Largest random delay on top of it, which also changes the order [s].
        bytes_per_s: Largest rate.
    """

    loss: float = 0.0
    delay_s: float = 0.0
    jitter_s: float = 0.0
    bytes_per_s: float = 1e9


class LossyLink:
    """Two namespaces, `names`, with the addresses 10.99.0.1 and 10.99.0.2; closes like a file.

    Attributes:
        names: Of the namespaces.
        quality: Of the link, both ways; may be changed at any time.
        lost: Packets lost.
        passed: Packets passed on.
    """

    def __init__(self) -> None:
        self.names = tuple(f'mixtac{os.getpid()}{side}' for side in 'ab')
        self.quality = Quality()
        self.lost = self.passed = 0
        self._stopping = threading.Event()
        self._ends: list[int] = []
        self._thread = threading.Thread(target=self._run, daemon=True)
        try:
            for number, name in enumerate(self.names, 1):
                ip('netns', 'add', name)
                self._ends.append(_tap(name))
                for words in (
                    f'addr add 10.99.0.{number}/24 dev tap0',
                    'link set tap0 up',
                    'link set lo up',
                    'route add 239.255.0.0/16 dev tap0',
                ):
                    ip('-n', name, *words.split())
        except BaseException:
            self.close()
            raise
        self._thread.start()

    def command(self, side: int, *words: str) -> list[str]:
        """Return a command that runs in a namespace, 0 or 1."""
        return ['ip', 'netns', 'exec', self.names[side], *words]

    def close(self) -> None:
        """Remove the namespaces."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()
        for end in self._ends:
            os.close(end)
        for name in self.names:
            with contextlib.suppress(subprocess.CalledProcessError):
                ip('netns', 'del', name)

    def _run(self) -> None:
        rng = random.Random(0)
        waiting: list[tuple[float, int, int, bytes]] = []
        free_s, number = [0.0, 0.0], 0
        while not self._stopping.is_set():
            now_s = time.monotonic()
            pause_s = min(0.05, max(0.0, waiting[0][0] - now_s)) if waiting else 0.05
            for end in select.select(self._ends, [], [], pause_s)[0]:
                packet, side = os.read(end, LARGEST), self._ends.index(end)
                quality, now_s = self.quality, time.monotonic()
                if rng.random() < quality.loss or len(waiting) >= MOST_WAITING:
                    self.lost += 1
                    continue
                free_s[side] = max(now_s, free_s[side]) + len(packet) / quality.bytes_per_s
                due_s = free_s[side] + quality.delay_s + rng.uniform(0.0, quality.jitter_s)
                number += 1
                heapq.heappush(waiting, (due_s, number, 1 - side, packet))
            now_s = time.monotonic()
            while waiting and waiting[0][0] <= now_s:
                _, _, side, packet = heapq.heappop(waiting)
                with contextlib.suppress(OSError):
                    os.write(self._ends[side], packet)
                self.passed += 1


def why_not() -> str:
    """Return why there can be no link here; empty where there can."""
    if shutil.which('ip') is None:
        return 'the command ip (iproute2) is not installed'
    try:
        LossyLink().close()
    except (OSError, subprocess.CalledProcessError) as error:
        return f'network namespaces cannot be made: {error}'
    return ''


def ip(*words: str) -> None:
    """Run the command ip."""
    subprocess.run(['ip', *words], check=True, capture_output=True)


def _tap(namespace: str) -> int:
    """Return the descriptor of a new device `tap0` in a namespace."""
    libc = ctypes.CDLL(None, use_errno=True)
    made: list[int | OSError] = []

    def make() -> None:
        # Only this thread enters the namespace, and it ends there.
        try:
            with Path(f'/run/netns/{namespace}').open('rb') as place:
                failed = libc.setns(place.fileno(), 0)
            if failed:
                made.append(OSError(ctypes.get_errno(), 'setns'))
                return
            # Else the rests of incomplete datagrams fill their memory for half a minute.
            Path('/proc/sys/net/ipv4/ipfrag_time').write_text('1', encoding='ascii')
            end = os.open('/dev/net/tun', os.O_RDWR | os.O_NONBLOCK)
            fcntl.ioctl(end, TUNSETIFF, struct.pack('16sH22x', b'tap0', IFF_TAP | IFF_NO_PI))
            made.append(end)
        except OSError as error:
            made.append(error)

    thread = threading.Thread(target=make)
    thread.start()
    thread.join()
    (found,) = made
    if isinstance(found, OSError):
        raise found
    return found
