# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""From recordings to presses with known forces."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mixtac_fger.adapt.loads import known_windows, load_label
from mixtac_fger.adapt.presses import cut_presses, part_of
from mixtac_fger.batches import stack
from mixtac_fger.dataset import CONTACT_N, MEASURED_CONTACT_N, make_sample
from mixtac_fger.errors import CalibrationError
from mixtac_fger.training import estimate
from mixtac_fger.windows_of_trial import camera_end_us

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mixtac_fger.adapt.loads import Load
    from mixtac_fger.dataset import Sample
    from mixtac_fger.network import FgerNetwork
    from mixtac_fger.trials.trial_arrays import TrialArrays

LONGEST_S = 60.0
"""More is not used [s]: calibrating a sensor is to be a matter of a minute."""


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """What a model is adapted by.

    Attributes:
        presses: Presses, forces nan where they are not known.
        used_s: Length of the recordings used [s].
        left_out_s: Length beyond the limit [s].
    """

    presses: list[Sample]
    used_s: float
    left_out_s: float


def gather_presses(
    network: FgerNetwork,
    trials: Iterable[TrialArrays],
    loads: Sequence[Load] = (),
    longest_s: float = LONGEST_S,
) -> Material:
    """Cut recordings of one sensor into presses.

    Args:
        network: The model to adapt; its estimates say where the sensor is released.
        trials: Recordings, each beginning without contact; with `loads`, one of unknown force.
        loads: Known loads of that recording; empty where the trials know their force.
        longest_s: Later parts are left out [s].

    Raises:
        CalibrationError: There is nothing to use.
        DatasetError: A recording cannot be used.
    """
    config = network.config
    most = round(longest_s * 1e6 / config.window_us)
    presses: list[Sample] = []
    used = left_out = 0
    for trial in trials:
        sample = _sample(network, trial, loads)
        taken = min(len(sample.force), most - used)
        used, left_out = used + taken, left_out + len(sample.force) - taken
        if taken > 0:
            kept = part_of(sample, 0, taken)
            force, _ = estimate(network, stack([replace(kept, force=np.zeros_like(kept.force))]))
            presses += cut_presses(kept, force[:, 0].numpy())
    if not presses:
        raise CalibrationError(
            'the model sees no press with a known force: press the sensor during the recording,'
            ' and let go in between'
        )
    return Material(presses, used * config.window_us / 1e6, left_out * config.window_us / 1e6)


def _sample(network: FgerNetwork, trial: TrialArrays, loads: Sequence[Load]) -> Sample:
    if not loads:
        label = trial.label()
        contact_n = CONTACT_N if label is trial.truth else MEASURED_CONTACT_N
        return make_sample(network.config, trial, label, trial.origin, contact_n)
    start_us = min(int(trial.events.t[0]), int(trial.exposure_start_us[0]))
    label = load_label(loads, start_us, camera_end_us(trial))
    sample = make_sample(network.config, trial, label, trial.origin, MEASURED_CONTACT_N)
    known = known_windows(loads, sample.window_end_us, start_us)
    return replace(sample, force=np.where(known, sample.force, np.float32(np.nan)))
