# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The paper's networks on a live stream, on a GPU where there is one, otherwise on the CPU.

A window is computed as in `mixtac_learning.paper.samples.run_samples`, one at a time. There are two
differences. The events between two frames, which the deep fusion reads, are counted in whole
windows, and a frame that arrives late belongs to a later window.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mixtac_core.events.arrays import Events
from mixtac_core.events.frames import bin_mean
from mixtac_fger.estimator import EncodedFrame, Estimator
from mixtac_fger.features import ImageError
from mixtac_fger.weights import Model
from mixtac_learning.network import count_parameters, usual_device
from mixtac_learning.paper.networks import (
    EventsOnly,
    FeatureFusion,
    FgerPaper,
    FrameModel,
    PaperState,
    operations_per_cycle,
    paper_network_of,
)
from mixtac_learning.paper.samples import (
    FULL_SCALE,
    SETTLE_FRAMES,
    event_counts,
    frame_input,
    packet_points,
)

LEFT_ALIGNED = 64
"""Value of the converter's lowest bit in a left-aligned image of 16 bits."""


class PaperEstimator(Estimator):
    """One of the paper's networks with its state.

    There is no no-contact reference that could be renewed: a network that reads frames against one
    uses the first `SETTLE_FRAMES` of its stream. The frames-only force of FGER-Net is its
    correction of no force; that of the network without frames is 0.

    Args:
        model: Weights are copied.
        device: Where to compute; empty for a GPU where there is one.

    Raises:
        ModelError: The model is of another architecture, or its tensors do not fit.
    """

    def __init__(self, model: Model, device: str = '') -> None:
        self._device = torch.device(device or usual_device())
        self._network = paper_network_of(model).to(self._device)
        self._config = config = self._network.config
        self.width, self.height, self.window_us = config.width, config.height, config.window_us
        self.parameters = count_parameters(self._network)
        self._frame: EncodedFrame | None = None
        self._rest: list[NDArray[np.float16]] = []
        self._counts = self._no_counts()
        self._state: PaperState
        self.clear()

    @property
    def operations(self) -> int:
        """Floating-point operations per frame interval of 40 ms at full load."""
        return operations_per_cycle(self._config)

    @torch.inference_mode()
    def encode(self, image: NDArray[np.uint8] | NDArray[np.uint16], mid_us: int) -> EncodedFrame:
        """Run the frame network.

        Raises:
            ImageError: The image has another size.
        """
        config, network = self._config, self._network
        if image.shape != (config.height, config.width):
            raise ImageError(
                f'image of shape {image.shape}; the model reads {config.height} rows and'
                f' {config.width} columns',
                remedy='set the camera to full resolution',
            )
        mean = np.empty(config.frame_shape, np.float32)
        bin_mean(image, config.scale, mean)
        full = 255.0 if image.dtype == np.uint8 else FULL_SCALE * LEFT_ALIGNED
        # As samples on disk are rounded.
        rounded = (mean / full).astype(np.float16)
        if len(self._rest) < SETTLE_FRAMES:
            self._rest.append(rounded)
        seen = frame_input(rounded[None], np.stack(self._rest), config)
        frame = torch.from_numpy(seen).to(self._device)
        if isinstance(network, EventsOnly):
            return EncodedFrame(mid_us, 0.0, 0, None)
        content = network.frame(frame)
        fused = isinstance(network, FeatureFusion)
        force = 0.0 if fused else float(network.force_of(content)[0])
        return EncodedFrame(mid_us, force, 0, content)

    def correct(self, frame: EncodedFrame, lag: int) -> None:  # noqa: ARG002
        """Use a frame in the next window, at whose end the estimate is corrected."""
        self._frame = frame

    def start_at(self, frame: EncodedFrame) -> None:
        """Start over, corrected by this frame at the end of the next window."""
        self.clear()
        self._frame = frame

    @torch.inference_mode()
    def step(self, events: Events, end_us: int) -> tuple[float, float | None]:
        """Advance by one window; return the force [N], and None for the standard deviation."""
        network, state = self._network, self._state
        frame, self._frame = self._frame, None
        if isinstance(network, (FgerPaper, EventsOnly)):
            features = self._event_features(network, events, end_us)
            if isinstance(network, EventsOnly):
                state = network.recurrence.step(features, state)
                force = state.force
            else:
                slots = torch.full((1,), -1 if frame is None else 0, device=self._device)
                frames = state.feature if frame is None else frame.content
                force, state = network.window(
                    features, frames, slots, state, arrives=frame is not None
                )
        else:
            if isinstance(network, FeatureFusion):
                ends = np.array([end_us - self._config.window_us, end_us])
                counts = event_counts(self._config, events, ends)[0].astype(np.int64)
                self._counts = np.minimum(self._counts + counts, 255)
            force = state.force
            if frame is not None:
                force = self._frame_force(network, frame.content)
                state = state._replace(force=force)
        self._state = state
        return float(force[0]), None

    def clear(self) -> None:
        """Forget the recurrent state."""
        self._state = self._network.initial_state(1)
        self._counts = self._no_counts()

    def _event_features(
        self, network: FgerPaper | EventsOnly, events: Events, end_us: int
    ) -> Tensor:
        points, _ = packet_points(self._config, events, np.array([end_us]))
        inputs = torch.from_numpy(points.astype(np.float32)).to(self._device)
        packet = torch.zeros(len(points), dtype=torch.int64, device=self._device)
        return network.recurrence.encoder(inputs, packet, 1)  # type: ignore[no-any-return]

    def _frame_force(self, network: FrameModel, content: Tensor) -> Tensor:
        if isinstance(network, FeatureFusion):
            counts, self._counts = self._counts, self._no_counts()
            events = torch.from_numpy(np.log1p(counts.astype(np.float32)))[None].to(self._device)
            content = torch.cat([content, network.events(events)], 1)
        return torch.Tensor(network.force_of(content))

    def _no_counts(self) -> NDArray[np.int64]:
        return np.zeros((2, *self._config.frame_shape), np.int64)
