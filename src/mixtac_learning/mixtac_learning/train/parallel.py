# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Data-parallel training under `torchrun`: every process has its own trials, all share gradients.

Gradients are averaged before each update, so that all processes keep the same weights. The gloo
backend works on CPUs and needs no launcher beyond `torchrun`.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import timedelta

import torch
import torch.distributed as dist
from torch import Tensor, nn

PATIENCE = timedelta(days=7)
"""How long processes wait for the one that prepares the data; by default it is half an hour."""


@dataclass(frozen=True, slots=True)
class Processes:
    """The place of this process among those that share the training.

    Attributes:
        rank: 0 to `world` - 1; only 0 writes files and prints.
        world: Number of processes.
    """

    rank: int = 0
    world: int = 1

    @staticmethod
    def join() -> Processes:
        """Join the processes that `torchrun` started; without it there is only this one."""
        world = int(os.environ.get('WORLD_SIZE', '1'))
        if world <= 1:
            return Processes()
        if not dist.is_initialized():
            dist.init_process_group('gloo', timeout=PATIENCE)
        return Processes(dist.get_rank(), world)

    def leave(self) -> None:
        """Leave the group."""
        if self.world > 1 and dist.is_initialized():
            dist.destroy_process_group()

    @property
    def leads(self) -> bool:
        """Whether this process writes files and reports."""
        return self.rank == 0

    def share(self, items: Sequence[int]) -> list[int]:
        """Return this process's part of a sequence, of nearly equal size."""
        return list(items[self.rank :: self.world])

    def average_gradients(self, parameters: Sequence[nn.Parameter]) -> None:
        """Average the gradients over all processes; a missing one counts as zero."""
        if self.world == 1:
            return
        for parameter in parameters:
            if parameter.grad is None:
                parameter.grad = torch.zeros_like(parameter)
        flat = torch.cat([p.grad.flatten() for p in parameters if p.grad is not None])
        flat = self.mean(flat)
        start = 0
        for parameter in parameters:
            size = parameter.numel()
            parameter.grad = flat[start : start + size].view_as(parameter).clone()
            start += size

    def mean(self, tensor: Tensor) -> Tensor:
        """Return the mean of a tensor over all processes."""
        if self.world == 1:
            return tensor
        total = tensor.detach().cpu().clone()
        dist.all_reduce(total)
        return (total / self.world).to(tensor.device)

    def smallest(self, number: int) -> int:
        """Return the smallest of all processes' numbers."""
        if self.world == 1:
            return number
        value = torch.tensor(number)
        dist.all_reduce(value, dist.ReduceOp.MIN)
        return int(value)

    def average_buffers(self, module: nn.Module) -> None:
        """Give all processes the mean of the running statistics."""
        if self.world == 1:
            return
        for buffer in module.buffers():
            if buffer.is_floating_point():
                buffer.copy_(self.mean(buffer))

    def wait(self) -> None:
        """Wait for all processes."""
        if self.world > 1:
            dist.barrier()
