# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The viewer's server and the stream to it, with the real rerun where it is installed."""

from __future__ import annotations

import importlib.util
import socket
import subprocess
import urllib.request
from contextlib import closing
from pathlib import Path

import numpy as np
import psutil
import pytest

from mixtac_cli.view import server as viewer_server
from mixtac_cli.view.server import HOST, ViewError, ViewerServer, free_port, require_rerun

pytestmark = pytest.mark.live
needs_rerun = pytest.mark.skipif(
    importlib.util.find_spec('rerun') is None, reason='rerun-sdk is not installed: make view'
)


def test_a_missing_viewer_is_named_with_its_remedy(monkeypatch):
    monkeypatch.setattr(viewer_server.importlib.util, 'find_spec', lambda name: None)
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


@needs_rerun
def test_the_page_is_served_on_this_machine_only_and_ends_with_its_owner():
    before = set(psutil.Process().children())
    with closing(ViewerServer(0, 0, 50)) as server:
        (child,) = set(psutil.Process().children()) - before
        listening = [c.laddr for c in child.net_connections('inet') if c.status == 'LISTEN']
        assert len(listening) == 2
        assert {each.ip for each in listening} == {HOST}
        page = urllib.request.urlopen(server.page_url.partition('?')[0], timeout=20).read()
        assert b'<canvas' in page.lower()
        assert child.environ()['TELEMETRY_ENABLED'] == 'false'
    assert not child.is_running()


@needs_rerun
def test_usage_data_are_off_and_the_users_own_settings_untouched(tmp_path, monkeypatch):
    monkeypatch.setenv('HOME', str(tmp_path))
    with closing(ViewerServer(0, 0, 50)) as server:
        settings = Path(server._home.name) / 'config' / 'rerun' / 'analytics.json'
        assert '"analytics_enabled":false' in settings.read_text().replace(' ', '')
    assert not (tmp_path / '.config').exists()


@needs_rerun
def test_a_server_that_ended_is_reported():
    before = set(psutil.Process().children())
    server = ViewerServer(0, 0, 50)
    (child,) = set(psutil.Process().children()) - before
    child.kill()
    child.wait()
    with pytest.raises(ViewError):
        server.check()
    server.close()


@needs_rerun
def test_what_is_drawn_is_in_the_file(tmp_path):
    from mixtac_cli.view.drawing import palette
    from mixtac_cli.view.page import Page

    path = tmp_path / 'view.rrd'
    page = Page(10.0, palette(), path=path)
    page.at(1_700_000_000_000_000_000)
    page.events(np.ones((4, 5), np.uint8))
    page.frame(np.zeros((4, 5), np.uint8))
    page.text('state', 'fine')
    times = np.arange(3, dtype=np.int64) + 1_700_000_000_000_000_000
    page.curve('force/estimate', (times, np.array([1.0, 2.0, 3.0])))
    page.curve('force/reference', (times[:0], np.zeros(0)))
    page.show_slip()
    page.close()
    printed = subprocess.run(
        [require_rerun(), 'rrd', 'print', path], capture_output=True, text=True, check=True
    ).stdout
    for entity in ('/events', '/frame', '/state', '/force/estimate'):
        assert entity in printed
