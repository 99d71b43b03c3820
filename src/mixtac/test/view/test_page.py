# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The viewer's server and the stream to it, with the real rerun where it is installed."""

from __future__ import annotations

import importlib.util
import socket
import subprocess
import time
import urllib.request
from contextlib import closing
from pathlib import Path

import numpy as np
import psutil
import pytest

from mixtac.view import page as view_page
from mixtac.view.page import HOST, Page, ViewError, ViewerServer, free_port, require_rerun

pytestmark = pytest.mark.live
needs_rerun = pytest.mark.skipif(
    importlib.util.find_spec('rerun') is None, reason='rerun-sdk is not installed: make view'
)


def test_a_missing_viewer_is_named_with_its_remedy(monkeypatch):
    monkeypatch.setattr(view_page.importlib.util, 'find_spec', lambda name: None)
    with pytest.raises(ViewError) as caught:
        require_rerun()
    assert 'make view' in caught.value.remedy


def test_a_port_in_use_is_named():
    with socket.socket() as other:
        other.bind((HOST, 0))
        other.listen()
        taken = other.getsockname()[1]
        with pytest.raises(ViewError) as caught:
            free_port(taken, 'port')
        assert f'port {taken}' in str(caught.value)


def listening(process: psutil.Process) -> set[str]:
    """Wait until the server listens on both its ports; return their addresses."""
    while True:
        found = [c.laddr for c in process.net_connections('inet') if c.status == 'LISTEN']
        if len(found) >= 2:
            return {each.ip for each in found}
        assert process.is_running()
        time.sleep(0.1)


@needs_rerun
def test_the_page_is_served_on_this_machine_only_and_ends_with_its_owner(tmp_path, monkeypatch):
    monkeypatch.setenv('HOME', str(tmp_path))
    before = set(psutil.Process().children())
    with closing(ViewerServer(0, 0, 50)) as server:
        (child,) = set(psutil.Process().children()) - before
        assert listening(child) == {HOST}
        page = urllib.request.urlopen(server.page_url.partition('?')[0], timeout=20).read()
        assert b'<canvas' in page.lower()
        assert child.environ()['TELEMETRY_ENABLED'] == 'false'
        settings = Path(child.environ()['XDG_CONFIG_HOME']) / 'rerun' / 'analytics.json'
        assert '"analytics_enabled":false' in settings.read_text().replace(' ', '')
        assert not (tmp_path / '.config').exists()
    assert not child.is_running()


@needs_rerun
def test_a_server_that_ended_is_reported():
    before = set(psutil.Process().children())
    with closing(ViewerServer(0, 0, 50)) as server:
        (child,) = set(psutil.Process().children()) - before
        child.kill()
        child.wait()
        with pytest.raises(ViewError):
            server.check()


@needs_rerun
def test_what_is_drawn_is_in_the_file(tmp_path):
    path = tmp_path / 'view.rrd'
    page = Page(10.0, path=path)
    page.at(1_700_000_000_000_000_000)
    page.events(np.ones((4, 5), np.uint8))
    page.frame(np.zeros((4, 5), np.uint8))
    page.contact(np.zeros((3, 2)))
    page.contact(None)
    page.text('fine')
    page.curve('force/estimate', [(1_700_000_000_000_000_000 + i, 1.5) for i in range(3)])
    page.curve('force/reference', [])
    page.close()
    printed = subprocess.run(
        [require_rerun(), 'rrd', 'print', path], capture_output=True, text=True, check=True
    ).stdout
    for entity in ('/events', '/frame', '/frame/contact', '/state', '/force/estimate'):
        assert entity in printed
