# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training samples of FGER-Net: the features of a trial with the force of each window."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixtac_fger.config import FgerConfig
from mixtac_fger.features import FramePreparation, WindowFeatures, correction_lag, mean_contrast
from mixtac_fger.shear import NEWTONS
from mixtac_learning.trials.store import read_arrays, write_arrays
from mixtac_learning.trials.trial import (
    DatasetError,
    ForceLabel,
    TrialArrays,
    frame_arrivals,
    window_ends,
)

CONTACT_N = 0.01
"""Largest true force during the reference frames [N]."""
MEASURED_CONTACT_N = 0.1
"""The same of a measured force, which has noise and a zero of its own [N] (estimate)."""
STORED = np.float16
"""Precision of stored features: 0.05 % is far below the noise, and memory is half."""


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """One trial as the network sees it; T windows, N frames.

    Attributes:
        window_end_us: Camera clock [us], int64 [T].
        event_features: float16 [T, grid rows, grid columns, 4].
        force: Label at the end of each window [N], float32 [T].
        across: Sideways force x, y [N] and torsion [N mm] there, nan if unknown, float32 [T, 3].
        slots: Frame that becomes available in each window, -1 for none, int64 [T].
        lags: Windows from the estimate before that to the centre of its exposure, int64 [T].
        frame_inputs: float16 [N, channels, rows, columns].
        frame_moments: Moments of each frame (`mixtac_fger.moments`), float32 [N, 9 or 0].
        frame_force: Mean label over each exposure [N], float32 [N].
        frame_across: As `across`, at the centre of each exposure, float32 [N, 3].
        origin: Seeds, profile, and the like.
    """

    window_end_us: NDArray[np.int64]
    event_features: NDArray[np.float16]
    force: NDArray[np.float32]
    across: NDArray[np.float32]
    slots: NDArray[np.int64]
    lags: NDArray[np.int64]
    frame_inputs: NDArray[np.float16]
    frame_moments: NDArray[np.float32]
    frame_force: NDArray[np.float32]
    frame_across: NDArray[np.float32]
    origin: dict[str, Any]


def make_sample(
    config: FgerConfig,
    trial: TrialArrays,
    label: ForceLabel,
    origin: dict[str, Any],
) -> Sample:
    """Compute the features of a trial, with frames available from their arrival on.

    The first `FgerConfig.reference_frames` frames must be without contact. Frames whose exposure
    the label does not cover are left out.

    Args:
        config: Network configuration.
        trial: Events and frames.
        label: Force on the camera clock.
        origin: Kept with the sample.

    Raises:
        DatasetError: The trial has too few frames, ends before they have arrived, or starts in
            contact.
    """
    kept = config.reference_frames
    width = config.window_us
    begin_us, end_us = trial.exposure_start_us, trial.exposure_end_us
    told = np.flatnonzero((begin_us >= label.t_us[0]) & (end_us <= label.t_us[-1]))
    told = told[told >= kept - 1]
    few = len(trial.frames) <= kept or not len(told)
    if few or label.t_us[-1] < trial.arrival_us[told[0]] + width:
        raise DatasetError(
            f'trial {origin} has {len(trial.frames)} frames: more than {kept} are needed, and'
            ' a label that lasts beyond them'
        )
    forces = label.mean(begin_us, end_us)
    contact_n = CONTACT_N if label is trial.truth else MEASURED_CONTACT_N
    if np.abs(forces[:kept]).max() > contact_n:
        raise DatasetError(
            f'trial {origin} starts with {np.abs(forces[:kept]).max():.2f} N: its first {kept}'
            ' frames must be without contact'
        )
    first = int(told[0])
    ends = window_ends(trial, label, width, int(trial.arrival_us[first]))
    slots = frame_arrivals(trial.arrival_us, ends, first)
    middle = (begin_us + end_us) // 2
    lags = [
        correction_lag(int(end) - width, int(middle[slot]), width) if slot >= 0 else 0
        for end, slot in zip(ends, slots, strict=True)
    ]
    inputs, moments, features = _features(config, trial, ends, slots, told)
    return Sample(
        window_end_us=ends,
        event_features=features,
        force=label.at(ends),
        across=_across(trial, ends),
        slots=np.where(slots >= 0, slots - first, -1),
        lags=np.array(lags, np.int64),
        frame_inputs=inputs,
        frame_moments=moments,
        frame_force=forces[told],
        frame_across=_across(trial, middle[told]),
        origin=origin,
    )


def _across(trial: TrialArrays, t_us: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return sideways force and torsion at some times, in the units of the network."""
    if trial.across is None:
        return np.full((len(t_us), 3), np.nan, np.float32)
    return (trial.across.at(t_us) / NEWTONS).astype(np.float32)


def _features(
    config: FgerConfig,
    trial: TrialArrays,
    ends: NDArray[np.int64],
    slots: NDArray[np.int64],
    frames: NDArray[np.int64],
) -> tuple[NDArray[np.float16], NDArray[np.float32], NDArray[np.float16]]:
    """Return inputs and moments of some frames, and the event features."""
    preparation, window = FramePreparation(config), WindowFeatures(config)
    kept = config.reference_frames
    first = [preparation.contrast(frame) for frame in trial.frames[:kept]]
    reference = mean_contrast([c.coarse for c in first])
    channels = len(config.frame_channels)
    inputs = np.empty((len(frames), channels, *config.frame_shape), STORED)
    moments = []
    for index, frame in enumerate(frames):
        contrast = preparation.contrast(trial.frames[frame])
        inputs[index] = preparation.network_input(contrast, reference)
        moments.append(preparation.moments())
    out = np.zeros(window.shape, np.float32)
    features = np.empty((len(ends), *window.shape), STORED)
    guide = preparation.guide(first[-1])
    cuts = np.searchsorted(trial.events.t, [ends[0] - config.window_us, *ends])
    for index, slot in enumerate(slots):
        if slot >= 0:
            guide = preparation.guide(preparation.contrast(trial.frames[slot]))
        light = window.compute(trial.events[cuts[index] : cuts[index + 1]], guide, out)
        features[index] = 0.0 if light else out
    return inputs, np.stack(moments), features


def save_sample(path: Path, sample: Sample, config: FgerConfig) -> None:
    """Write a sample with its configuration as a folder of arrays, whole or not at all."""
    arrays = {name: getattr(sample, name) for name in _ARRAYS}
    facts = {'config': config.to_dict(), 'origin': sample.origin}
    write_arrays(path, arrays, facts, _FACTS)


_ARRAYS = Sample.__slots__[:-1]
_FACTS = 'sample.json'
UNSEEN_BY_SAMPLES = {
    'reference_stillness',
    'event_hidden',
    'event_size',
    'frame_widths',
    'frame_size',
    'lstm_size',
    'mlp_size',
    'event_shortcut',
    'frame_context',
    'deviation_size',
    'force_unit',
    'shear',
    'correction_point',
    'history_windows',
}
"""Fields of the configuration that do not change what a sample holds."""


def load_sample(path: Path, config: FgerConfig) -> Sample:
    """Read a sample and check that it was prepared as `config` asks.

    Raises:
        DatasetError: The folder is missing, damaged or was prepared in another way.
    """
    mapped, facts = read_arrays(path, _FACTS, _ARRAYS)
    wanted = config.to_dict()
    for name in set(wanted) - UNSEEN_BY_SAMPLES:
        if facts['config'].get(name) != wanted[name]:
            raise DatasetError(
                f'sample {path} was prepared with {name} = {facts["config"].get(name)}, but'
                f' {wanted[name]} is needed: remove it'
            )
    arrays = {name: np.array(mapped[name]) for name in _ARRAYS}
    return Sample(**arrays, origin=facts['origin'])


def sample_origin(path: Path) -> dict[str, Any]:
    """Return where a sample came from.

    Raises:
        DatasetError: The folder cannot be read.
    """
    return dict(read_arrays(path, _FACTS, ())[1]['origin'])


def sample_windows(path: Path) -> int:
    """Return the number of windows of a sample.

    Raises:
        DatasetError: The folder cannot be read.
    """
    return len(read_arrays(path, _FACTS, ('force',))[0]['force'])


@dataclass(frozen=True, slots=True)
class FgerRecipe:
    """Features of frames and windows, in one folder per trial.

    Attributes:
        config: Network configuration.
        label: Which force to learn, one of `mixtac_learning.trials.trial.LABELS`.
    """

    config: FgerConfig
    label: str = 'best'
    suffix = '.fger'

    def fingerprint(self) -> dict[str, Any]:
        """Return what changes a sample."""
        fields = self.config.to_dict()
        kept = {name: fields[name] for name in fields if name not in UNSEEN_BY_SAMPLES}
        return {'kind': 'fger 6', 'label': self.label} | kept

    def write(self, trial: TrialArrays, path: Path) -> None:
        """Prepare a trial and write it, whole or not at all.

        Raises:
            DatasetError: As `make_sample`, or the trial has no such force.
        """
        sample = make_sample(self.config, trial, trial.label(self.label), trial.origin)
        save_sample(path, sample, self.config)
