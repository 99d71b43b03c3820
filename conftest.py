# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fixtures that all packages share."""

from __future__ import annotations

import contextlib
import fcntl
import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

# 0 is everybody's default; above 100 the ports run into Linux's ephemeral range.
DOMAINS = range(1, 100)


@contextlib.contextmanager
def leased_domain() -> Iterator[dict[str, str]]:
    """Lease a ROS domain id, set it for this process, and yield the environment."""
    folder = Path(tempfile.gettempdir()) / f'mixtac-domains-{os.getuid()}'
    folder.mkdir(exist_ok=True)
    for domain in DOMAINS:
        with (folder / str(domain)).open('w') as lease:
            try:
                fcntl.flock(lease, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            with pytest.MonkeyPatch.context() as patch:
                patch.setenv('ROS_DOMAIN_ID', str(domain))
                patch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
                yield dict(os.environ)
            return
    pytest.fail(f'all {len(DOMAINS)} ROS domains are leased by running tests')


@pytest.fixture
def ros_domain() -> Iterator[dict[str, str]]:
    """Lease a ROS domain of this test's own, discovered on this machine only.

    The variables are set for the test's process; the environment is also yielded, for processes
    that the test starts.
    """
    with leased_domain() as env:
        yield env


@pytest.fixture(scope='module')
def module_ros_domain() -> Iterator[dict[str, str]]:
    """Lease a ROS domain for all tests of a module that share one running graph."""
    with leased_domain() as env:
        yield env
