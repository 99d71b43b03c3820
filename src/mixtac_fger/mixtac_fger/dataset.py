# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training samples: what the network would have seen during a trial, with the force beside it."""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from mixtac_fger.errors import DatasetError
from mixtac_fger.features import FramePreparation, WindowFeatures, correction_lag, mean_contrast
from mixtac_fger.windows_of_trial import frame_arrivals, window_ends

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from mixtac_events.arrays import Events
    from mixtac_fger.config import FgerConfig

CONTACT_N = 0.01
"""Largest true force during the reference frames [N]."""
MEASURED_CONTACT_N = 0.1
"""The same of a measured force, which has noise and a zero of its own [N] (estimate)."""
STORED = np.float16
"""Precision of stored features: 0.05 % is far below the noise, and memory is half."""


class RecordedTrial(Protocol):
    """What a trial must offer, as `mixtac_sim.trial.Trial` does; camera clock [us]."""

    @property
    def events(self) -> Events:
        """Events, sorted."""

    @property
    def frames(self) -> NDArray[np.uint16]:
        """Intensities [N, height, width]."""

    @property
    def exposure_start_us(self) -> NDArray[np.int64]:
        """When each exposure began [N]."""

    @property
    def exposure_end_us(self) -> NDArray[np.int64]:
        """When it ended [N]."""

    @property
    def arrival_us(self) -> NDArray[np.int64]:
        """When the host had the frame [N]."""


@dataclass(frozen=True, slots=True, eq=False)
class ForceLabel:
    """The force to learn, as a curve.

    Attributes:
        t_us: Camera clock [us], increasing.
        force: Normal force [N], positive when pressed.
    """

    t_us: NDArray[np.float64]
    force: NDArray[np.float64]

    def at(self, t_us: NDArray[np.integer]) -> NDArray[np.float32]:
        """Return the force at times on the camera clock."""
        return np.asarray(np.interp(t_us, self.t_us, self.force), np.float32)

    def mean(self, start_us: NDArray[np.int64], end_us: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return the mean force from `start_us` to `end_us` (trapezoids on the curve's samples)."""
        steps = np.diff(self.t_us) * 0.5 * (self.force[1:] + self.force[:-1])
        integral = np.concatenate([[0.0], np.cumsum(steps)])
        start, end = (np.interp(t, self.t_us, integral) for t in (start_us, end_us))
        return np.asarray((end - start) / np.maximum(end_us - start_us, 1), np.float32)


def true_force(truth: NDArray[np.void]) -> ForceLabel:
    """Return the label of a simulated trial's truth (fields `t_us` and `fz`)."""
    return ForceLabel(truth['t_us'].astype(np.float64), truth['fz'].astype(np.float64))


def aligned_force(
    reference_t_us: NDArray[np.floating] | NDArray[np.integer],
    force: NDArray[np.floating],
    scale: float,
    offset_us: float,
) -> ForceLabel:
    """Return the label of a reference sensor's samples after alignment.

    Args:
        reference_t_us: Reference clock [us].
        force: Normal force [N] of each sample.
        scale: a of the fit t_reference = a t_camera + b.
        offset_us: b of the fit [us].
    """
    t_us = np.asarray((reference_t_us - offset_us) / scale, np.float64)
    return ForceLabel(t_us, force.astype(np.float64))


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """One trial as the network sees it; T windows, N frames.

    Attributes:
        window_end_us: Camera clock [us], int64 [T].
        event_features: float16 [T, grid rows, grid columns, 4].
        force: Label at the end of each window [N], float32 [T].
        slots: Frame that becomes available in each window, -1 for none, int64 [T].
        lags: Windows from the estimate before that to the centre of its exposure, int64 [T].
        frame_inputs: float16 [N, channels, rows, columns].
        frame_force: Mean label over each exposure [N], float32 [N].
        origin: Seeds, profile, and the like.
    """

    window_end_us: NDArray[np.int64]
    event_features: NDArray[np.float16]
    force: NDArray[np.float32]
    slots: NDArray[np.int64]
    lags: NDArray[np.int64]
    frame_inputs: NDArray[np.float16]
    frame_force: NDArray[np.float32]
    origin: dict[str, Any]


def make_sample(
    config: FgerConfig,
    trial: RecordedTrial,
    label: ForceLabel,
    origin: dict[str, Any],
    contact_n: float = CONTACT_N,
) -> Sample:
    """Compute the features of a trial, with frames available from their arrival on.

    The first `FgerConfig.reference_frames` frames must be without contact.

    Args:
        config: Network configuration.
        trial: Events and frames.
        label: Force on the camera clock.
        origin: Kept with the sample.
        contact_n: A larger force during the reference frames is a contact [N].

    Raises:
        DatasetError: The trial has too few frames, ends before they have arrived, or begins in
            contact.
    """
    kept = config.reference_frames
    width = config.window_us
    if len(trial.frames) <= kept or label.t_us[-1] < trial.arrival_us[kept - 1] + width:
        raise DatasetError(
            f'trial {origin} has {len(trial.frames)} frames: more than {kept} are needed, and'
            ' a label that lasts beyond them'
        )
    forces = label.mean(trial.exposure_start_us, trial.exposure_end_us)
    if np.abs(forces[:kept]).max() > contact_n:
        raise DatasetError(
            f'trial {origin} begins with {np.abs(forces[:kept]).max():.2f} N: its first {kept}'
            ' frames must be without contact'
        )
    ends = window_ends(trial, label, width, int(trial.arrival_us[kept - 1]))
    slots = frame_arrivals(trial.arrival_us, ends, kept - 1)
    middle = (trial.exposure_start_us + trial.exposure_end_us) // 2
    lags = [
        correction_lag(int(end) - width, int(middle[slot]), width) if slot >= 0 else 0
        for end, slot in zip(ends, slots, strict=True)
    ]
    inputs, features = _features(config, trial, ends, slots)
    return Sample(
        window_end_us=ends,
        event_features=features,
        force=label.at(ends),
        slots=np.where(slots >= 0, slots - (kept - 1), -1),
        lags=np.array(lags, np.int64),
        frame_inputs=inputs,
        frame_force=forces[kept - 1 :],
        origin=origin,
    )


def _features(
    config: FgerConfig,
    trial: RecordedTrial,
    ends: NDArray[np.int64],
    slots: NDArray[np.int64],
) -> tuple[NDArray[np.float16], NDArray[np.float16]]:
    """Return the inputs of the frame network from the reference on, and the event features."""
    preparation, window = FramePreparation(config), WindowFeatures(config)
    kept = config.reference_frames
    first = [preparation.contrast(frame) for frame in trial.frames[:kept]]
    reference = mean_contrast([c.coarse for c in first])
    count = len(trial.frames) - (kept - 1)
    channels = len(config.frame_channels)
    inputs = np.empty((count, channels, *config.frame_shape), STORED)
    for index in range(count):
        contrast = preparation.contrast(trial.frames[index + kept - 1])
        inputs[index] = preparation.network_input(contrast, reference)
    out = np.zeros(window.shape, np.float32)
    features = np.empty((len(ends), *window.shape), STORED)
    guide = preparation.guide(first[-1])
    cuts = np.searchsorted(trial.events.t, [ends[0] - config.window_us, *ends])
    for index, slot in enumerate(slots):
        if slot >= 0:
            guide = preparation.guide(preparation.contrast(trial.frames[slot]))
        window.compute(trial.events[cuts[index] : cuts[index + 1]], guide, out)
        features[index] = out
    return inputs, features


def save_sample(path: Path, sample: Sample, config: FgerConfig) -> None:
    """Write a sample as .npz (no pickles) with its configuration."""
    path.parent.mkdir(parents=True, exist_ok=True)
    header = json.dumps({'config': config.to_dict(), 'origin': sample.origin})
    arrays = {name: getattr(sample, name) for name in _ARRAYS}
    partial = path.with_suffix('.partial.npz')
    np.savez(partial, header=np.array(header), **arrays)
    partial.replace(path)


_ARRAYS = (
    'window_end_us',
    'event_features',
    'force',
    'slots',
    'lags',
    'frame_inputs',
    'frame_force',
)
UNSEEN_BY_SAMPLES = {
    'reference_stillness',
    'event_hidden',
    'event_size',
    'frame_widths',
    'frame_size',
    'lstm_size',
    'mlp_size',
    'event_shortcut',
    'deviation_size',
    'correction_point',
    'history_windows',
}
"""Fields of the configuration that do not change what a sample holds."""


def load_sample(path: Path, config: FgerConfig) -> Sample:
    """Read a sample and check that it was prepared as `config` asks.

    Raises:
        DatasetError: The file is missing, damaged or was prepared in another way.
    """
    header, arrays = _read_part(
        path,
        lambda file: (json.loads(str(file['header'])), {name: file[name] for name in _ARRAYS}),
    )
    wanted = config.to_dict()
    for name in set(wanted) - UNSEEN_BY_SAMPLES:
        if header['config'].get(name) != wanted[name]:
            raise DatasetError(
                f'sample {path} was prepared with {name} = {header["config"].get(name)}, but'
                f' {wanted[name]} is needed: generate it anew'
            )
    return Sample(**arrays, origin=header['origin'])


def sample_origin(path: Path) -> dict[str, Any]:
    """Return where the sample in a file came from, without reading the rest.

    Raises:
        DatasetError: The file cannot be read.
    """
    return dict(_read_part(path, lambda file: json.loads(str(file['header']))['origin']))


def sample_windows(path: Path) -> int:
    """Return the number of windows of the sample in a file.

    Raises:
        DatasetError: The file cannot be read.
    """
    return int(_read_part(path, lambda file: len(file['force'])))


def _read_part(path: Path, part: Callable[[Any], Any]) -> Any:  # noqa: ANN401
    try:
        with np.load(path, allow_pickle=False) as file:
            return part(file)
    except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise DatasetError(f'sample {path} cannot be read ({error}): generate it anew') from error
