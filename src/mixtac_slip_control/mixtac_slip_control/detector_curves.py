# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Both detectors on the same trials: latency against false alarms, as numbers for curves.

Thresholds are swept, so nothing is tuned on what is evaluated: a curve shows every threshold, and
the shipped one is a point on it. Scores are the quantities that the detectors compare with their
thresholds, in units of the tail of the background that each trial begins with.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_slip_control.detector import CountDetector, CountSettings
from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.flow_detector import FlowDetector, FlowSettings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from mixtac_slip_control.slip_features import SlipWindow

    Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ScoredTrial:
    """The windows of one trial as each detector sees them, after the learning.

    Attributes:
        end_us: Ends of the windows [n], camera clock [us].
        count: Count over its threshold [n]: above 1 the shipped detector fires.
        flow: Flow over its threshold [n].
    """

    end_us: NDArray[np.int64]
    count: Floats
    flow: Floats


@dataclass(frozen=True, slots=True, eq=False)
class DetectorCurve:
    """One detector at one speed.

    Attributes:
        scale: Thresholds as multiples of the shipped one [m].
        false_alarms_per_min: Onsets per minute without slip [m].
        latency_ms: Median time from onset to detection [m]; infinite where most are missed.
        latency_p99_ms: Its 99th percentile [m].
        missed: Part of the trials without a detection [m].
        auc: Probability that the highest score in the first windows of a slip exceeds that of as
            many windows without slip.
    """

    scale: Floats
    false_alarms_per_min: Floats
    latency_ms: Floats
    latency_p99_ms: Floats
    missed: Floats
    auc: float


def score_trial(
    windows: Sequence[SlipWindow],
    learning: int,
    count: CountSettings | None = None,
    flow: FlowSettings | None = None,
) -> ScoredTrial:
    """Return the scores of a trial.

    Args:
        windows: All windows of the trial, the first ones at rest.
        learning: How many of them the detectors learn from; they are not scored.
        count: Settings of the paper's law.
        flow: Settings of the flow detector.

    Raises:
        SlipControlError: Too few windows to learn from.
    """
    by_count, by_flow = CountDetector(count), FlowDetector(flow)
    for window in windows[:learning]:
        by_count.update(window)
        by_flow.update(window)
        by_count.learn(window)
        by_flow.learn(window)
    if not (by_count.learned and by_flow.learned):
        raise SlipControlError(
            f'{min(learning, len(windows))} windows do not suffice to learn the background: give '
            'as many as the settings ask for, with frames'
        )
    rows = np.empty((2, len(windows) - learning))
    for column, window in zip(rows.T, windows[learning:], strict=True):
        by_count.update(window)
        by_flow.update(window)
        middle = by_count.background.median
        column[0] = (window.count - middle) / (by_count.threshold - middle)
        column[1] = by_flow.flow / by_flow.threshold
    ends = np.array([window.end_us for window in windows[learning:]], np.int64)
    return ScoredTrial(ends, rows[0], rows[1])


def detector_curve(
    detector: str,
    slips: Sequence[tuple[ScoredTrial, int]],
    quiet: Sequence[ScoredTrial],
    scale: Floats | None = None,
    *,
    horizon_us: int = 50_000,
    rest_us: int = 5_000,
) -> DetectorCurve:
    """Return latency against false alarms of a detector.

    Args:
        detector: `flow` or `count`.
        slips: Trials with slip and its onset, camera clock [us].
        quiet: Trials without slip, in which every onset of the detector is false.
        scale: Thresholds to try, as multiples of the shipped one.
        horizon_us: Detections later than this after the onset are misses [us].
        rest_us: Two crossings nearer than this are one alarm [us].

    Raises:
        SlipControlError: Nothing to evaluate, or an unknown detector.
    """
    if detector not in ('flow', 'count') or not slips or not quiet:
        raise SlipControlError(
            f'detector {detector!r}, {len(slips)} trials with slip, {len(quiet)} without: give '
            'flow or count and at least one of each'
        )
    scales = np.geomspace(0.02, 3.0, 60) if scale is None else scale
    calm = [(trial.end_us, getattr(trial, detector)) for trial in quiet]
    minutes = sum(float(end[-1] - end[0]) for end, _ in calm) / 60e6
    alarms = [sum(_onsets(t, s > k, rest_us) for t, s in calm) / minutes for k in scales]
    late = np.array(
        [[_latency(trial, detector, on, k, horizon_us) for trial, on in slips] for k in scales]
    )
    return DetectorCurve(
        scale=np.asarray(scales),
        false_alarms_per_min=np.array(alarms),
        latency_ms=np.quantile(late, 0.5, axis=1, method='higher'),
        latency_p99_ms=np.quantile(late, 0.99, axis=1, method='higher'),
        missed=np.mean(np.isinf(late), axis=1),
        auc=_auc(detector, slips, calm),
    )


def _onsets(times: NDArray[np.int64], above: NDArray[np.bool_], rest_us: int) -> int:
    hits = times[above]
    return 0 if len(hits) == 0 else 1 + int(np.count_nonzero(np.diff(hits) > rest_us))


def _latency(
    trial: ScoredTrial, detector: str, onset_us: int, threshold: float, horizon_us: int
) -> float:
    """Return the time from onset to the end of the first window above [ms]."""
    scores = getattr(trial, detector)
    first, last = np.searchsorted(trial.end_us, (onset_us, onset_us + horizon_us), side='right')
    found = np.flatnonzero(scores[first:last] > threshold)
    return float(trial.end_us[first + found[0]] - onset_us) * 1e-3 if len(found) else np.inf


def _auc(
    detector: str,
    slips: Sequence[tuple[ScoredTrial, int]],
    calm: Sequence[tuple[NDArray[np.int64], Floats]],
    span: int = 5,
) -> float:
    """Return the area under the curve of the highest of 5 scores (Mann and Whitney)."""
    positive = []
    for trial, onset in slips:
        first = int(np.searchsorted(trial.end_us, onset, side='right'))
        part = getattr(trial, detector)[first : first + span]
        positive.append(float(part.max()) if len(part) else -np.inf)
    negative = np.concatenate(
        [s[: len(s) // span * span].reshape(-1, span).max(axis=1) for _, s in calm]
    )
    negative.sort()
    below = np.searchsorted(negative, positive, side='left')
    tied = np.searchsorted(negative, positive, side='right') - below
    return float(np.mean((below + 0.5 * tied) / len(negative)))
