# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training in stages: the frame network, the recurrent path on top of it, both together."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn
from torch.nn.functional import smooth_l1_loss

from mixtac_fger.batches import mirror_events, mirror_frames
from mixtac_fger.network import FgerNetwork, FrameSlots, SequenceState

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from mixtac_fger.batches import Sequences
    from mixtac_fger.config import FgerConfig
    from mixtac_fger.training_settings import TrainingSettings

    Report = Callable[[str, int, int, float], None]

_GRADIENT_NORM = 1.0
_ENCODE_BATCH = 512


class Trainer:
    """Trains one network on a set of sequences.

    How stiff a gel is cannot be seen: force is stiffness times what is seen. So each sensor of the
    training data has a gain, learned with the frame network and drawn towards 1, and the network
    learns the force on a gel of usual stiffness. A new sensor's gain is 1 until it is calibrated
    (`mixtac_fger.calibration`).

    Args:
        config: Network configuration.
        settings: Stages and rates.
        report: Called after each epoch with (stage, epoch, epochs, mean loss).
    """

    def __init__(
        self, config: FgerConfig, settings: TrainingSettings, report: Report | None = None
    ) -> None:
        torch.manual_seed(settings.seed)
        self.network = FgerNetwork(config)
        self._settings = settings
        self._report = report or (lambda *_: None)
        self._log_gains = nn.Parameter(torch.zeros(0))
        self._random = torch.Generator().manual_seed(settings.seed)

    @property
    def gains(self) -> Tensor:
        """Gain of each sensor of the training data, by `Sequences.device`."""
        return self._log_gains.detach().exp()

    def run(self, sequences: Sequences) -> FgerNetwork:
        """Run all stages and return the network in evaluation mode."""
        fit_scales(self.network, sequences)
        self.train_frames(sequences)
        self.train_recurrent(sequences)
        self.train_jointly(sequences)
        return self.network.eval()

    def train_frames(self, sequences: Sequences) -> None:
        """Stage 1: the frame network with its own force output."""
        settings = self._settings
        frames, labels = sequences.frame_inputs, sequences.frame_force
        batches = -(-len(labels) // settings.frame_batch)
        steps = settings.frame_epochs * batches
        self._log_gains = nn.Parameter(torch.zeros(int(sequences.device.max()) + 1))
        learned = [*self.network.frame.parameters(), self._log_gains]
        optimiser, schedule = self._optimiser(learned, settings.frame_rate, steps)
        device = sequences.device[sequences.frame_trial]
        for epoch in range(settings.frame_epochs):
            total = 0.0
            order = torch.randperm(len(labels), generator=self._random)
            for rows in torch.split(order, settings.frame_batch):
                inputs = mirror_frames(frames[rows].float(), self.network.config, *self._flips())
                force = self.network.frame.force(self.network.frame(inputs))
                gain = self._log_gains[device[rows]].exp()
                loss = smooth_l1_loss(gain * force, labels[rows], beta=settings.loss_knee_n)
                loss = loss + settings.gain_prior * self._log_gains.square().mean()
                self._update(loss, optimiser, schedule)
                total += loss.item() * len(rows) / len(labels)
            self._report('frames', epoch + 1, settings.frame_epochs, total)

    def train_recurrent(self, sequences: Sequences) -> None:
        """Stage 2: events, LSTM and corrections on the frozen frame network."""
        settings = self._settings
        flips = [(c, r) for c in (False, True) for r in (False, True)]
        encoded = {
            f: encode(self.network, sequences, *f) for f in flips[: 4 if settings.mirror else 1]
        }
        trained = nn.ModuleList(m for m in self.network.children() if m is not self.network.frame)
        self._train_sequences(
            'recurrent',
            sequences,
            trained,
            settings.recurrent_epochs,
            settings.recurrent_rate,
            lambda flip, slots: (encoded[flip], slots),
        )

    def train_jointly(self, sequences: Sequences) -> None:
        """Stage 3: everything together, at a low rate."""
        settings = self._settings

        def encode_now(flip: tuple[bool, bool], slots: FrameSlots) -> tuple[Tensor, FrameSlots]:
            used, index = torch.unique(slots.frame.clamp(min=0), return_inverse=True)
            inputs = mirror_frames(sequences.frame_inputs[used].float(), self.network.config, *flip)
            local = torch.where(slots.frame >= 0, index, -1)
            return self.network.frame(inputs), FrameSlots(local, slots.lag)

        self._train_sequences(
            'joint', sequences, self.network, settings.joint_epochs, settings.joint_rate, encode_now
        )

    def _train_sequences(
        self,
        stage: str,
        sequences: Sequences,
        trained: nn.Module,
        epochs: int,
        rate: float,
        frame_features: Callable[[tuple[bool, bool], FrameSlots], tuple[Tensor, FrameSlots]],
    ) -> None:
        """Run epochs of truncated back-propagation through all sequences side by side."""
        settings = self._settings
        length, count = sequences.force.shape
        steps = epochs * -(-length // settings.chunk_windows)
        optimiser, schedule = self._optimiser(list(trained.parameters()), rate, steps)
        for epoch in range(epochs):
            flip = self._flips()
            state = self.network.initial_state(count)
            total = 0.0
            for start, stop in self._chunks(length):
                slots = FrameSlots(*(part[start:stop] for part in sequences.slots))
                features, local = frame_features(flip, slots)
                events = mirror_events(sequences.event_features[start:stop].float(), *flip)
                force, state = self.network(events, features, local, state)
                loss = self._loss(force, sequences, slice(start, stop))
                self._update(loss, optimiser, schedule)
                state = state.detached()
                total += loss.item() * (stop - start) / length
            self._report(stage, epoch + 1, epochs, total)

    def _chunks(self, length: int) -> Iterator[tuple[int, int]]:
        """Yield the stretches of one epoch; the first is cut at random so that borders move."""
        size = self._settings.chunk_windows
        first = int(torch.randint(size // 2, size + 1, (1,), generator=self._random))
        borders = [0, *range(min(first, length), length, size), length]
        yield from ((a, b) for a, b in pairwise(borders) if b > a)

    def _loss(self, force: Tensor, sequences: Sequences, windows: slice) -> Tensor:
        valid = sequences.valid[windows]
        scaled = (self.gains[sequences.device] * force)[valid]
        knee = self._settings.loss_knee_n
        return smooth_l1_loss(scaled, sequences.force[windows][valid], beta=knee)

    def _flips(self) -> tuple[bool, bool]:
        if not self._settings.mirror:
            return False, False
        columns, rows = torch.randint(0, 2, (2,), generator=self._random).tolist()
        return bool(columns), bool(rows)

    def _optimiser(
        self, learned: list[nn.Parameter], rate: float, steps: int
    ) -> tuple[torch.optim.Optimizer, torch.optim.lr_scheduler.LRScheduler]:
        optimiser = torch.optim.AdamW(learned, lr=rate, weight_decay=self._settings.weight_decay)
        # A random first stretch makes some epochs one update longer than counted.
        schedule = torch.optim.lr_scheduler.LambdaLR(optimiser, _warm_cosine(max(steps, 1)))
        return optimiser, schedule

    def _update(
        self,
        loss: Tensor,
        optimiser: torch.optim.Optimizer,
        schedule: torch.optim.lr_scheduler.LRScheduler,
    ) -> None:
        optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        parameters: Iterable[Tensor] = (
            p for group in optimiser.param_groups for p in group['params']
        )
        nn.utils.clip_grad_norm_(parameters, _GRADIENT_NORM)
        optimiser.step()
        schedule.step()


def _warm_cosine(steps: int) -> Callable[[int], float]:
    """Return the learning-rate factor: up within 5 %, then down to 2 % along a cosine."""

    def factor(step: int) -> float:
        if step < 0.05 * steps:
            return (step + 1) / (0.05 * steps + 1)
        phase = min((step - 0.05 * steps) / (0.95 * steps), 1.0)
        return 0.02 + 0.49 * (1.0 + float(torch.cos(torch.tensor(torch.pi * phase))))

    return factor


def fit_scales(network: FgerNetwork, sequences: Sequences) -> None:
    """Set the input scales to the spread of the data; signed inputs keep their zero."""
    events = sequences.event_features[sequences.valid].float()
    network.event.scale.copy_(events.flatten(0, -2).square().mean(0).sqrt().clamp(min=1e-3))
    frames = sequences.frame_inputs.float()
    scale = frames.square().mean((0, 2, 3)).sqrt()
    if 'frame' in network.config.frame_channels:
        channel = network.config.frame_channels.index('frame')
        network.frame.mean[channel] = frames[:, channel].mean()
        scale[channel] = frames[:, channel].std()
    network.frame.scale.copy_(scale.clamp(min=1e-3)[:, None, None])


@torch.no_grad()
def encode(
    network: FgerNetwork, sequences: Sequences, columns: bool = False, rows: bool = False
) -> Tensor:
    """Return f_frame of all frames, [N, frame_size], optionally of their mirror images."""
    parts = torch.split(sequences.frame_inputs, _ENCODE_BATCH)
    flipped = (mirror_frames(part.float(), network.config, columns, rows) for part in parts)
    return torch.cat([network.frame(part) for part in flipped])


@torch.no_grad()
def estimate(network: FgerNetwork, sequences: Sequences) -> tuple[Tensor, Tensor]:
    """Run all sequences from their start.

    Returns:
        Force at the end of each window [T, B] and frames-only force of each frame [N], in N.
    """
    features = encode(network, sequences)
    state: SequenceState = network.initial_state(sequences.force.shape[1])
    force, _ = network(sequences.event_features.float(), features, sequences.slots, state)
    return force, network.frame.force(features)
