# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A tiny training run in a process of its own: fit a line; may be killed, may be one of several.

Arguments: folder, epoch after which the process kills itself (0 for never).
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

import torch

from mixtac_learning.train import loop

EPOCHS = 12
POINTS = 41
"""Of two processes, the first has 21: an update more than the other."""


class LineStage(loop.Stage):
    """Batches of a line with noise, in random order.

    Args:
        model: The line.
        own: Numbers of the points of this process.
    """

    name, epochs, rate = 'line', EPOCHS, 0.05

    def __init__(self, model: torch.nn.Module, own: Sequence[int]) -> None:
        points = torch.Generator().manual_seed(3)
        x = torch.rand(POINTS, 1, generator=points)
        y = 2.0 * x - 0.5 + 0.1 * torch.randn(POINTS, 1, generator=points)
        self.model = model
        self.x, self.y = x[own], y[own]

    def parameters(self) -> list[torch.nn.Parameter]:
        return list(self.model.parameters())

    def updates(self) -> int:
        return 4

    def losses(self, random: torch.Generator):
        rows = torch.randperm(len(self.x), generator=random)
        for part in rows.split(5):
            noise = 0.0 * torch.rand(1)  # the global random state is part of a run as well
            yield (self.model(self.x[part]) + noise - self.y[part]).square().mean()


def fit(folder: Path, kill_after: int) -> loop.TrainingLoop:
    torch.manual_seed(7)
    model = torch.nn.Linear(1, 1)

    def show(stage, epoch, epochs, text) -> None:
        if kill_after and epoch == kill_after + 1:
            # In the middle: the epoch is done, its checkpoint is not written.
            os.kill(os.getpid(), signal.SIGKILL)

    training = loop.TrainingLoop(
        model,
        seed=5,
        checkpoint=folder / 'checkpoint.safetensors',
        fingerprint='line',
        show=show,
    )
    training.run([LineStage(model, loop.share(range(POINTS)))])
    return training


if __name__ == '__main__':
    torch.set_num_threads(1)
    loop.join_processes()
    done = fit(Path(sys.argv[1]) / str(loop.rank()), int(sys.argv[2]))
    weights = [float(value) for value in done.module.state_dict().values()]
    (Path(sys.argv[1]) / f'weights_{loop.rank()}.txt').write_text(repr(weights))
    loop.leave_processes()
