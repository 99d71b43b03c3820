# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac simulate`: its bags."""

from __future__ import annotations

import pytest
import typer
from typer.testing import CliRunner

from mixtac.simulate import simulate
from mixtac_core.recordings.dataset import DatasetDescription
from mixtac_sim import SimulationError

app = typer.Typer()
app.command()(simulate)


def run(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


def test_bags_are_written_and_counted(tmp_path):
    out = tmp_path / 'set'
    words = ('--profile', 'idle', '--trials', 2, '--seconds', 3, '--preset', 'easy', '--out', out)
    result = run(*words, '--jobs', 1, '--compress')
    assert result.exit_code == 0, result.output
    assert '2 bags written' in ' '.join(result.output.split())
    assert '0 bags written' in run(*words, '--jobs', 1).output
    description = DatasetDescription.read(out)
    assert (description.name, description.preset, description.complete) == ('idle', 'easy', True)


@pytest.mark.parametrize(
    'words',
    [
        (),
        ('--profile', 'idle'),
        ('--profile', 'idle', '--dataset', 'static', '--out', 'x'),
        ('--out', 'x'),
        ('--profile', 'idle', '--trials', 0, '--out', 'x'),
        ('--profile', 'idle', '--preset', 'dance', '--out', 'x'),
    ],
)
def test_wrong_usage_is_refused(words):
    assert run(*words).exit_code == 2


@pytest.mark.parametrize('option', ['--profile', '--dataset'])
def test_what_does_not_exist_is_an_expected_failure(option, tmp_path):
    result = run(option, 'dance', '--out', tmp_path / 'y', '--seconds', 3)
    assert isinstance(result.exception, SimulationError)
