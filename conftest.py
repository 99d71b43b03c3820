# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fixtures that all packages share."""

from __future__ import annotations

import fcntl
import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

# Domain ids that Linux leaves free of ephemeral ports; 0 is everybody's default.
DOMAINS = range(1, 100)


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, str]]:
    """Lease a ROS domain of this test's own, discovered on this machine only.

    The variables are set for the test's process; the environment is also yielded, for processes
    that the test starts.
    """
    folder = Path(tempfile.gettempdir()) / f'mixtac-domains-{os.getuid()}'
    folder.mkdir(exist_ok=True)
    for domain in DOMAINS:
        lease = (folder / str(domain)).open('w')
        try:
            fcntl.flock(lease, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lease.close()
            continue
        with lease:
            monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
            monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
            yield dict(os.environ)
        return
    pytest.fail(f'all {len(DOMAINS)} ROS domains are leased by running tests')
