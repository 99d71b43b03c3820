# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The frame network, compiled: one call without the interpreter lock, in preallocated memory.

A frame step of many small calls would release and acquire the lock many times, and the thread that
closes windows might have to wait each time. The torch network of `mixtac_learning.network` is the
reference that this is tested against.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_fger.config import FgerConfig, map_shapes
from mixtac_fger.weights import Tensors

F32 = NDArray[np.float32]
TAPS = 9
"""Of a 3 x 3 kernel."""


class RowScratch(NamedTuple):
    """Scratch memory for one row of a convolution's output, float32.

    Attributes:
        patches: Neighbours of each pixel, [columns, 9 inputs].
        sums: Products with the kernel, [columns, outputs].
    """

    patches: F32
    sums: F32


Maps = tuple[F32, ...]
Scratch = tuple[RowScratch, ...]


class FrameWeights(NamedTuple):
    """Weights of the frame network, float32; maps are [rows, columns, channels].

    Attributes:
        mean: Of each input channel.
        scale: Of each input channel.
        spread: Of each moment; empty without moments.
        kernels: Of each convolution, [9 inputs, outputs], the 3 x 3 neighbours row by row.
        biases: Of each convolution, [outputs].
        project: [rows, columns, channels, frame_size].
        project_bias: [frame_size].
        head: [feature_size].
        head_bias: One element.
    """

    mean: F32
    scale: F32
    spread: F32
    kernels: tuple[F32, ...]
    biases: tuple[F32, ...]
    project: F32
    project_bias: F32
    head: F32
    head_bias: F32


def frame_weights(tensors: Tensors, config: FgerConfig) -> FrameWeights:
    """Return copies of the weights in the layout of the compiled step.

    Args:
        tensors: Tensors of a weight file; shapes: `mixtac_fger.config.tensor_shapes`.
        config: Network configuration.
    """
    layers = [f'frame.convolutions.{2 * index}' for index in range(len(config.frame_widths))]
    rows, columns = map_shapes(config)[-1][:2]
    project = copied(tensors['frame.project.weight'])
    project = project.reshape(config.frame_size, -1, rows, columns)
    return FrameWeights(
        mean=copied(tensors['frame.mean']).ravel(),
        scale=copied(tensors['frame.scale']).ravel(),
        spread=copied(tensors.get('frame.spread', np.zeros(0))),
        kernels=tuple(_kernel(tensors[f'{layer}.weight']) for layer in layers),
        biases=tuple(copied(tensors[f'{layer}.bias']) for layer in layers),
        project=copied(project.transpose(2, 3, 1, 0)),
        project_bias=copied(tensors['frame.project.bias']),
        head=copied(tensors['frame.head.weight']).ravel(),
        head_bias=copied(tensors['frame.head.bias']),
    )


def frame_maps(config: FgerConfig) -> Maps:
    """Return scratch memory for the input and the output of each convolution.

    Maps have a border of zeros, one pixel on each side, which is never written to.
    """
    return tuple(
        np.zeros((rows + 2, columns + 2, channels), np.float32)
        for rows, columns, channels in map_shapes(config)
    )


def row_scratch(config: FgerConfig) -> Scratch:
    """Return scratch memory for each convolution."""
    shapes = map_shapes(config)
    return tuple(
        RowScratch(
            np.zeros((after[1], TAPS * before[2]), np.float32),
            np.zeros((after[1], after[2]), np.float32),
        )
        for before, after in pairwise(shapes)
    )


def copied(tensor: NDArray[np.generic]) -> F32:
    """Return a C-ordered float32 copy."""
    return np.array(tensor, np.float32, order='C')


def _kernel(weight: NDArray[np.generic]) -> F32:
    """Return [outputs, inputs, 3, 3] as [9 inputs, outputs]."""
    outputs = weight.shape[0]
    return copied(weight.transpose(2, 3, 1, 0).reshape(-1, outputs))


@njit(cache=True, nogil=True, fastmath={'contract'})
def _convolve(source: F32, kernel: F32, bias: F32, scratch: RowScratch, out: F32) -> None:
    """Write relu(convolution), stride 2; both maps with a border of zeros."""
    columns, inputs = out.shape[1] - 2, source.shape[2]
    for row in range(out.shape[0] - 2):
        for i in range(3):
            line = source[2 * row + i]
            for column in range(columns):
                for j in range(3):
                    for channel in range(inputs):
                        place = (3 * i + j) * inputs + channel
                        scratch.patches[column, place] = line[2 * column + j, channel]
        # A row at a time: the library starts threads of its own for larger products.
        np.dot(scratch.patches, kernel, scratch.sums)
        for column in range(columns):
            for channel in range(bias.shape[0]):
                value = scratch.sums[column, channel] + bias[channel]
                out[row + 1, column + 1, channel] = max(value, np.float32(0.0))


@njit(cache=True, nogil=True)
def _normalise(inputs: F32, mean: F32, scale: F32, out: F32) -> None:
    """Write the scaled input as the first map."""
    channels, rows, columns = inputs.shape
    for channel in range(channels):
        for row in range(rows):
            for column in range(columns):
                value = (inputs[channel, row, column] - mean[channel]) / scale[channel]
                out[row + 1, column + 1, channel] = value


@njit(cache=True, nogil=True, fastmath={'contract'})
def _project(source: F32, weights: FrameWeights, feature: F32) -> None:
    """Write relu(linear) of the last map."""
    for index in range(feature.shape[0]):
        feature[index] = weights.project_bias[index]
    for row in range(source.shape[0] - 2):
        for column in range(source.shape[1] - 2):
            for channel in range(source.shape[2]):
                value = source[row + 1, column + 1, channel]
                # Half of what leaves a ReLU is zero.
                if value != 0.0:
                    for index in range(feature.shape[0]):
                        feature[index] += value * weights.project[row, column, channel, index]
    for index in range(feature.shape[0]):
        feature[index] = max(feature[index], np.float32(0.0))


@njit(cache=True, nogil=True)
def frame_step(
    inputs: F32, moments: F32, weights: FrameWeights, maps: Maps, scratch: Scratch, feature: F32
) -> Any:  # noqa: ANN401
    """Write f_frame and return the frames-only force [N].

    Args:
        inputs: Network input, float32 [channels, rows, columns].
        moments: Of the displacement (`mixtac_fger.shear`), float32 [9]; empty for none.
        weights: Weights of the frame network.
        maps: Of `frame_maps`; changed.
        scratch: Of `row_scratch`; changed.
        feature: float32 [feature_size], written to.
    """
    _normalise(inputs, weights.mean, weights.scale, maps[0])
    for layer in range(len(weights.kernels)):
        kernel, bias = weights.kernels[layer], weights.biases[layer]
        _convolve(maps[layer], kernel, bias, scratch[layer], maps[layer + 1])
    found = weights.project_bias.shape[0]
    _project(maps[len(maps) - 1], weights, feature[:found])
    for index in range(moments.shape[0]):
        feature[found + index] = moments[index] / weights.spread[index]
    force = weights.head_bias[0]
    for index in range(feature.shape[0]):
        force += feature[index] * weights.head[index]
    return force
