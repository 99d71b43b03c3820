# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Running a model over trials; those that cannot be used are named."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mixtac_events.errors import MixtacError
from mixtac_fger.calibration import fit_scale
from mixtac_fger.errors import CalibrationError, DatasetError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from mixtac_fger.judge.trial_estimate import TrialEstimate, TrialEstimator
    from mixtac_fger.trials.trial_source import TrialSource

    Advance = Callable[[], object]


@dataclass(slots=True)
class Judged:
    """Estimates of trials.

    Attributes:
        estimates: Of those that could be used.
        skipped: Why the others could not, by name.
    """

    estimates: list[TrialEstimate] = field(default_factory=list)
    skipped: dict[str, str] = field(default_factory=dict)


def judge_sources(
    estimator: TrialEstimator,
    sources: Iterable[TrialSource],
    advance: Advance = lambda: None,
) -> Judged:
    """Estimate all trials, one in memory at a time.

    Args:
        estimator: The model.
        sources: Trials.
        advance: Called after each.

    Raises:
        DatasetError: No trial can be used.
    """
    judged = Judged()
    for source in sources:
        try:
            judged.estimates.append(estimator.estimate(source.load()))
        except MixtacError as error:
            judged.skipped[source.name] = str(error)
        advance()
    if not judged.estimates:
        first = next(iter(judged.skipped.values()), 'there are none')
        raise DatasetError(f'none of {len(judged.skipped)} trials can be judged: {first}')
    return judged


def sensor_scales(
    estimator: TrialEstimator,
    presses: Iterable[TrialSource],
    advance: Advance = lambda: None,
    fallback: float | None = None,
) -> dict[str, float]:
    """Return the scale of each sensor from one press against a known force.

    Args:
        estimator: The model.
        presses: One trial per sensor that nothing else is judged on.
        advance: Called after each.
        fallback: Scale of a sensor whose press the model does not see; None to fail.

    Raises:
        CalibrationError: As said.
        MixtacError: A press cannot be used.
    """
    scales = {}
    for source in presses:
        press = estimator.estimate(source.load())
        try:
            scales[press.device] = fit_scale(press.force, press.known).force_scale
        except CalibrationError:
            if fallback is None:
                raise
            scales[press.device] = fallback
        advance()
    return scales
