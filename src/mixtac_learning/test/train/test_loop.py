# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Killed runs go on as if nothing had happened; two processes train as one."""

from __future__ import annotations

import ast
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from mixtac_learning.train.loop import (
    Stage,
    TrainingError,
    TrainingLoop,
    load_checkpoint,
    schedule_factor,
)

SCRIPT = Path(__file__).with_name('line_fit.py')


def run_script(*arguments: object, launcher: tuple[str, ...] = ()) -> subprocess.CompletedProcess:
    command = [sys.executable, *launcher, str(SCRIPT), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=150, check=False)


def weights(loop: TrainingLoop) -> list[float]:
    return [float(value) for value in loop.module.state_dict().values()]


def written_weights(folder: Path, rank: int) -> list[float]:
    return ast.literal_eval((folder / f'weights_{rank}.txt').read_text())


def test_a_killed_run_goes_on_to_the_same_weights(tmp_path):
    (tmp_path / 'whole').mkdir()
    (tmp_path / 'killed').mkdir()
    fit = runpy.run_path(str(SCRIPT))['fit']
    whole = fit(tmp_path / 'whole', 0)
    killed = run_script(tmp_path / 'killed', 5)
    assert killed.returncode == -9
    found = load_checkpoint(tmp_path / 'killed' / '0' / 'checkpoint.safetensors', 'line')
    assert found is not None
    assert found[0].epoch == 5
    resumed = fit(tmp_path / 'killed' / '0', 0)
    assert weights(resumed) == weights(whole)


def test_two_processes_with_unequal_data_share_gradients_and_keep_the_same_weights(tmp_path):
    launcher = ('-m', 'torch.distributed.run', '--standalone', '--nproc_per_node', '2')
    done = run_script(tmp_path, 0, launcher=launcher)
    assert done.returncode == 0, done.stderr
    assert written_weights(tmp_path, 0) == written_weights(tmp_path, 1)
    assert written_weights(tmp_path, 0) == pytest.approx(_averaged_by_hand(), abs=1e-6)
    assert not (tmp_path / '1' / 'checkpoint.safetensors').exists()


def _averaged_by_hand() -> list[float]:
    """Train with the mean of both halves' losses in one process."""
    script = runpy.run_path(str(SCRIPT))
    torch.manual_seed(7)
    model = torch.nn.Linear(1, 1)
    stages = [script['LineStage'](model, range(script['POINTS'])[rank::2]) for rank in range(2)]
    randoms = [torch.Generator().manual_seed(5) for _ in stages]
    optimiser = torch.optim.AdamW(model.parameters(), lr=0.05, weight_decay=1e-3)
    for epoch in range(script['EPOCHS']):
        both = [stage.losses(random) for stage, random in zip(stages, randoms, strict=True)]
        for update, losses in enumerate(zip(*both, strict=False)):
            factor = schedule_factor('cosine', (epoch + update / 4) / script['EPOCHS'])
            optimiser.param_groups[0]['lr'] = 0.05 * factor
            optimiser.zero_grad()
            (sum(losses) / 2).backward()
            torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
            optimiser.step()
    return [float(value) for value in model.state_dict().values()]


class ScriptedStage(Stage):
    """Given validation errors; every epoch moves the only weight by about the rate."""

    name, rate = 'scripted', 0.1

    def __init__(self, errors: list[float | None], epochs: int) -> None:
        self.errors, self.epochs = list(errors), epochs
        self.weight = torch.nn.Parameter(torch.zeros(1))
        self.seen: list[float] = []

    def parameters(self):
        return [self.weight]

    def updates(self) -> int:
        return 1

    def losses(self, random):
        yield -self.weight.sum()

    def validate(self):
        self.seen.append(self.weight.item())
        return self.errors[len(self.seen) - 1]


def scripted(errors, patience=0, path=None) -> tuple[ScriptedStage, TrainingLoop]:
    # With patience, the first error is that of the weights that the stage begins with.
    stage = ScriptedStage(errors, len(errors) - (patience > 0))
    module = torch.nn.Module()
    module.weight = stage.weight
    loop = TrainingLoop(module, patience=patience, schedule='constant', checkpoint=path)
    loop.run([stage])
    return stage, loop


@pytest.mark.parametrize(
    ('errors', 'patience', 'epochs', 'kept'),
    [
        ([6.0, 5.0, 3.0, 4.0, 3.5, 1.0], 2, 4, 2),  # ends early, and goes back to the best
        ([2.0, 5.0, 3.0, 4.0], 5, 3, 0),  # ends as it began
        ([5.0, 3.0, 4.0, 3.5, 6.0], 0, 5, -1),
    ],
)
def test_a_stage_keeps_its_best_weights_where_it_has_patience(errors, patience, epochs, kept):
    stage, loop = scripted(errors, patience)
    assert [row['epoch'] for row in loop.progress.curves] == list(range(1, epochs + 1))
    assert stage.weight.item() == stage.seen[kept]


def test_a_checkpoint_of_another_run_is_refused(tmp_path):
    path = tmp_path / 'c.safetensors'
    scripted([1.0], path=path)
    with pytest.raises(TrainingError):
        load_checkpoint(path, 'another')
    path.write_bytes(b'cut off')
    with pytest.raises(TrainingError):
        load_checkpoint(path, '')
    assert load_checkpoint(tmp_path / 'none', '') is None


def test_a_loss_that_is_no_number_ends_the_run():
    stage = ScriptedStage([None], 1)
    stage.losses = lambda random: iter([stage.weight.sum() * float('nan')])
    with pytest.raises(TrainingError):
        TrainingLoop(torch.nn.Module()).run([stage])


def test_schedules():
    assert schedule_factor('constant', 0.7) == 1.0
    assert schedule_factor('cosine', 0.05) == pytest.approx(1.0)
    assert schedule_factor('cosine', 1.0) == pytest.approx(0.02)
    falling = [schedule_factor('cosine', 0.05 + 0.095 * k) for k in range(11)]
    assert falling == sorted(falling, reverse=True)
    with pytest.raises(TrainingError):
        schedule_factor('step', 0.1)
