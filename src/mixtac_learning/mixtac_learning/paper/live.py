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

from mixtac_core.events.arrays import Events
from mixtac_core.events.frames import bin_mean
from mixtac_fger.estimator import EncodedFrame, Estimator
from mixtac_fger.features import ImageError
from mixtac_fger.weights import Model
from mixtac_learning.network import usual_device
from mixtac_learning.paper.networks import EventsOnly, PaperState, SegmentBatch, paper_network_of
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

    Raises:
        ModelError: The model is of another architecture, or its tensors do not fit.
    """

    def __init__(self, model: Model) -> None:
        self._device = torch.device(usual_device())
        self._network = paper_network_of(model).to(self._device)
        self._config = config = self._network.config
        self.width, self.height, self.window_us = config.width, config.height, config.window_us
        self._frame: EncodedFrame | None = None
        self._rest: list[NDArray[np.float16]] = []
        self._counts = self._no_counts()
        self._state: PaperState
        self.clear()

    @torch.inference_mode()
    def encode(self, image: NDArray[np.uint8] | NDArray[np.uint16], mid_us: int) -> EncodedFrame:
        """Run the frame network.

        Raises:
            ImageError: The image has another size.
        """
        config, network = self._config, self._network
        if image.shape != (config.height, config.width):
            wanted = f'the model reads {config.height} rows and {config.width} columns'
            raise ImageError(
                f'image of {image.shape}: {wanted}', remedy='set the camera to full resolution'
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
        force = 0.0 if config.model == 'fusion' else float(network.force_of(content)[0])
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
        config, frame, self._frame = self._config, self._frame, None
        points, _ = packet_points(config, events, np.array([end_us]))
        if config.model == 'fusion':
            borders = np.array([end_us - config.window_us, end_us])
            counts = event_counts(config, events, borders).astype(np.int64)
            self._counts = np.minimum(self._counts + counts, 255)
        content = None if frame is None else frame.content
        batch = SegmentBatch(
            points=torch.from_numpy(points.astype(np.float32)),
            packet=torch.zeros(len(points), dtype=torch.int64),
            frames=torch.zeros(0, config.channels) if content is None else content,
            event_frames=torch.from_numpy(np.log1p(self._counts.astype(np.float32))),
            slots=torch.full((1, 1), -1 if content is None else 0),
            before=torch.tensor([-1]),
            force=torch.zeros(1, 1),
        )
        force, self._state = self._network(batch.to(self._device), self._state)
        if content is not None:
            self._counts = self._no_counts()
        return float(force[0, 0]), None

    def clear(self) -> None:
        """Forget the recurrent state."""
        self._state = self._network.initial_state(1)
        self._counts = self._no_counts()

    def _no_counts(self) -> NDArray[np.int64]:
        return np.zeros((1, 2, *self._config.frame_shape), np.int64)
