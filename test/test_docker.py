# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The images are pinned, multi-stage, non-root, of files that exist; the unit of systemd."""

from __future__ import annotations

import configparser
import re
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
DOCKERFILES = sorted((ROOT / 'docker').glob('*Dockerfile'))
COMPOSE = yaml.safe_load((ROOT / 'docker' / 'compose.yaml').read_text())


def instructions(path: Path) -> list[tuple[str, str]]:
    """Return (instruction, arguments), continuation lines joined, comments left out."""
    text = re.sub(r'^\s*#.*\n', '', path.read_text(), flags=re.MULTILINE).replace('\\\n', ' ')
    return [
        (each.partition(' ')[0], each.partition(' ')[2].strip())
        for each in text.splitlines()
        if each.strip()
    ]


@pytest.mark.parametrize('path', DOCKERFILES, ids=lambda p: p.name)
def test_images_are_pinned_multi_stage_and_not_root(path):
    defaults = dict(re.findall(r'^ARG (\w+)=(\S+)', path.read_text(), re.MULTILINE))
    bases = [text.split()[0] for name, text in instructions(path) if name == 'FROM']
    assert len(bases) > 1
    for base in bases:
        image = re.sub(r'\$\{(\w+)\}', lambda m: defaults[m[1]], base)
        assert image.partition(':')[2] not in {'', 'latest'}
    last = dict(instructions(path))
    assert last['USER'] not in {'root', '0'}
    # `ros2 launch` leaves its nodes running on SIGTERM.
    assert last['STOPSIGNAL'] == 'SIGINT'
    assert last['ENTRYPOINT'].startswith('[')


@pytest.mark.parametrize('path', DOCKERFILES, ids=lambda p: p.name)
def test_what_is_copied_is_there_and_in_the_context(path):
    context = (ROOT / '.dockerignore').read_text().splitlines()
    for name, text in instructions(path):
        if name == 'COPY' and '--from' not in text:
            *sources, _ = [word for word in text.split() if not word.startswith('--')]
            for source in sources:
                assert (ROOT / source).exists(), source
                assert f'!{source.split("/")[0]}' in context, source


def test_services_share_an_image_and_have_a_profile_each():
    assert set(COMPOSE['services']) == {'sensor', 'sensor-cuda', 'virtual', 'view'}
    for service in COMPOSE['services'].values():
        assert service['profiles']
        assert (ROOT / service['build']['dockerfile']).exists()
        assert service['cap_drop'] == ['ALL']
        assert not service.get('privileged')
        known = set(re.findall(r'^ARG (\w+)', DOCKERFILES[0].read_text(), re.MULTILINE))
        assert set(service['build']['args']) <= known
        command = service['command']
        assert command == ['mixtac', 'view'] or (ROOT / 'launch' / command[3]).exists()


def test_the_service_starts_again_after_a_failure_only_and_ends_as_ctrl_c_does():
    from mixtac.main import INTERRUPTED
    from mixtac_core.node.process import STOP_GRACE_S

    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str
    unit.read(ROOT / 'config' / 'systemd' / 'mixtac.service')
    service = unit['Service']
    assert service['Restart'] == 'on-failure'
    assert int(service['SuccessExitStatus']) == INTERRUPTED
    assert (service['KillSignal'], service['KillMode']) == ('SIGINT', 'mixed')
    assert float(service['TimeoutStopSec']) > STOP_GRACE_S
    assert Path(service['ExecStart'].split()[0]).name == 'mixtac'
