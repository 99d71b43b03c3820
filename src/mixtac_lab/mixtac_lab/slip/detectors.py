# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""False alarms and latency curves of the slip detectors on scenes with and without slip.

Thresholds are swept, so nothing is tuned on the evaluation data: a curve shows every threshold,
and the shipped one is a point on it. Scores are the quantities that the detectors compare with
their thresholds, in units of the background tail learned at the start of each trial.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from mixtac_lab.store import Piece, code_version
from mixtac_sim.grasp.slip_scene import SlipScene, knock_profile
from mixtac_sim.grids import STEP_US
from mixtac_sim.optics.scene import Flicker
from mixtac_sim.world.effects import preset
from mixtac_slip_control.detectors import CountDetector, Detectors, FlowDetector
from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.features import SlipFeatures
from mixtac_slip_control.parameters import DETECTORS, SlipControlParameters

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray
    from rich.console import Console

    from mixtac_lab.store import Store
    from mixtac_sim.grasp.slip_scene import SceneBlock
    from mixtac_slip_control.features import SlipWindow

    Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ScoredTrial:
    """Scores of the windows of one trial after the learning.

    Attributes:
        end_us: Ends of the windows [n], camera clock [us].
        count: Ratio of the count to its threshold [n]: the shipped detector reports slip above 1.
        flow: Ratio of the flow to its threshold [n].
    """

    end_us: NDArray[np.int64]
    count: Floats
    flow: Floats


@dataclass(frozen=True, slots=True, eq=False)
class DetectorCurve:
    """One detector at one speed.

    Attributes:
        scale: Thresholds as multiples of the shipped one [m].
        false_alarms_per_min: Reported onsets per minute without slip [m].
        latency_ms: Median time from onset to detection [m]; infinite where most are missed.
        latency_p99_ms: Its 99th percentile [m].
        missed: Share of trials without a detection [m].
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
    settings: SlipControlParameters | None = None,
) -> ScoredTrial:
    """Return the scores of a trial.

    Args:
        windows: All windows of the trial; the first ones are at rest.
        learning: Number of windows from which the detectors learn; they are not scored.
        settings: Settings of the detectors.

    Raises:
        SlipControlError: Too few windows to learn from.
    """
    chosen = settings or SlipControlParameters()
    by_count, by_flow = CountDetector(chosen), FlowDetector(chosen)
    for window in windows[:learning]:
        by_count.update(window)
        by_flow.update(window)
        by_count.learn(window)
        by_flow.learn(window)
    if not (by_count.learned and by_flow.learned):
        raise SlipControlError(
            f'{min(learning, len(windows))} windows do not suffice to learn the background',
            remedy='give as many windows as the settings require, with frames',
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
    """Return latency versus false alarms of a detector.

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
            f'detector {detector!r}, {len(slips)} trials with slip, {len(quiet)} without',
            remedy='give flow or count and at least one trial of each kind',
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
    """Return the time from the onset to the end of the first window above the threshold [ms]."""
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
    """Return the area under the ROC curve of the maximum of `span` scores (Mann and Whitney)."""
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


QuietName = Literal['hold', 'load', 'flicker']
QUIET: tuple[QuietName, ...] = get_args(QuietName)
FORCE_N = 0.7
SWING_N = 0.3
"""Amplitude of the force in a slow load change [N]."""
SWING_HZ = (0.25, 0.5, 1.0)
"""Frequencies of the load change, by the seed of the scene [Hz]: up to 1 N/s."""
LOAD_RATIO = 0.6
"""Ratio of the pull to the friction limit in scenes without slip."""
FLICKER_HZ = 100.0
"""A lamp at 50 Hz mains flickers with both half waves [Hz]."""
FLICKER_DEPTHS = (0.08, 0.12, 0.15)
"""Ripple of the light in the sensor, by the seed of the scene: a lamp with 30 % ripple that makes a
quarter, 40 % or half of the light, beside the steady LED of the sensor (estimates; an opaque skin
lets far less light in). From about 20 % the pixels fire by themselves and saturate the readout."""
BLOCK_STEPS = 32


def quiet_blocks(
    name: QuietName, seconds: float, seed: int, preset_name: str
) -> Iterator[SceneBlock]:
    """Yield the sensor data of an object that does not slip, in blocks of 4 ms.

    Args:
        name: Steady hold, slow change of the load, or flickering lamps.
        seconds: Length [s].
        seed: Seed of sensor and day.
        preset_name: Difficulty preset of the sensor.
    """
    scene = SlipScene(
        seed,
        seed,
        preset(preset_name),
        force_n=FORCE_N,
        load_ratio=LOAD_RATIO,
        flicker=flicker_of(seed) if name == 'flicker' else None,
    )
    still = np.zeros(BLOCK_STEPS)
    for block in range(round(1e6 * seconds / (BLOCK_STEPS * STEP_US))):
        force = None
        if name == 'load':
            t = 1e-6 * STEP_US * (block * BLOCK_STEPS + np.arange(BLOCK_STEPS) + 1)
            turns = SWING_HZ[seed % len(SWING_HZ)] * t
            force = FORCE_N + SWING_N * 0.5 * (1.0 - np.cos(2.0 * np.pi * turns))
        yield scene.advance(still, force)


def flicker_of(seed: int) -> Flicker:
    """Return the flicker of a scene."""
    phase = (0.618 * seed) % 1.0
    return Flicker(FLICKER_DEPTHS[seed % len(FLICKER_DEPTHS)], FLICKER_HZ, phase)


def slip_blocks(
    speed_mm_s: float, onset_s: float, seconds: float, seed: int, preset_name: str
) -> Iterator[SceneBlock]:
    """Yield the sensor data of an object that slips once, in blocks of 1 ms.

    Args:
        speed_mm_s: Speed of the slip [mm/s].
        onset_s: Onset of the slip [s].
        seconds: Length [s].
        seed: Seed of sensor and day.
        preset_name: Difficulty preset of the sensor.
    """
    scene = SlipScene(seed, seed, preset(preset_name), force_n=FORCE_N)
    return scene.play(knock_profile(speed_mm_s, onset_s, seconds - onset_s, seconds))


def windows_of(
    blocks: Iterator[SceneBlock], settings: SlipControlParameters
) -> Iterator[SlipWindow]:
    """Yield the windows of a scene, as the controller forms them.

    Args:
        blocks: Data of the scene.
        settings: Settings of the controller.
    """
    features = SlipFeatures(settings)
    for block in blocks:
        for frame in block.frames:
            middle = (frame.exposure_start_us + frame.exposure_end_us) // 2
            features.frame(frame.intensity, middle)
        yield from features.push(block.events, block.end_us)


SPEEDS_MM_S = (10.0, 30.0, 100.0)
LEARN_S = 1.1
SLIP_TRIAL_S = 1.2
QUIET_TRIAL_S = 5.0
PIECE_S = 60.0
"""Length of the pieces of a long scene, each with its own sensor and day [s]."""
QUIET_SEED = 50_000
"""First seed of the sensors of quiet scenes; no threshold was tuned on them."""
SLIP_SEED = 60_000


@dataclass(frozen=True, slots=True)
class Alarms:
    """False alarms on one kind of quiet scene.

    Attributes:
        name: Kind of scene.
        seconds: Simulated time after the background was learned [s].
        flow: Onsets reported by the flow detector.
        count: Onsets reported by the count law.
        mean_count: Mean events per window.
        saturated: Windows with a saturated sensor, which would stop an arm.
    """

    name: str
    seconds: float
    flow: int
    count: int
    mean_count: float
    saturated: int


def count_alarms(
    name: QuietName,
    seconds: float,
    settings: SlipControlParameters,
    preset_name: str,
    store: Store,
    console: Console,
) -> Alarms:
    """Return the false alarms of both detectors with their shipped thresholds.

    Args:
        name: Kind of scene.
        seconds: Simulated time without the learning [s].
        settings: Settings of the controller.
        preset_name: Difficulty preset of the sensors.
        store: Stored results.
        console: Shows the progress.
    """
    number = max(round(seconds / PIECE_S), 1)
    version = code_version('mixtac_events', 'mixtac_sim', 'mixtac_slip_control', __name__)
    arguments = [(name, k, seconds / number, settings, preset_name) for k in range(number)]
    pieces = [Piece(f'quiet_{name}_{each[1]}', _quiet_piece, each, version) for each in arguments]
    found = store.run_shown(f'scene without slip: {name}', pieces, console)
    parts = [Alarms(**each) for each in found]
    return Alarms(
        name,
        sum(p.seconds for p in parts),
        sum(p.flow for p in parts),
        sum(p.count for p in parts),
        float(np.mean([p.mean_count for p in parts])),
        sum(p.saturated for p in parts),
    )


def _quiet_piece(
    _base: Path,
    name: QuietName,
    number: int,
    seconds: float,
    settings: SlipControlParameters,
    preset_name: str,
) -> dict[str, Any]:
    """Return the alarms of one sensor on one day, for JSON."""
    both, before = Detectors(settings), dict.fromkeys(DETECTORS, False)
    alarms = dict.fromkeys(DETECTORS, 0)
    counts = windows = saturated = 0
    blocks = quiet_blocks(name, LEARN_S + seconds, QUIET_SEED + number, preset_name)
    for window in windows_of(blocks, settings):
        both.update(window, 0.0)
        slipping = {'flow': both.flow.slipping, 'count': both.count.slipping}
        if window.end_us > 1e6 * LEARN_S:
            for each in DETECTORS:
                alarms[each] += slipping[each] and not before[each]
            counts, windows = counts + window.count, windows + 1
            saturated += window.count >= settings.saturation_count
        before = slipping
    mean = counts / max(windows, 1)
    return asdict(Alarms(name, seconds, alarms['flow'], alarms['count'], mean, saturated))


def curves(
    trials: int,
    settings: SlipControlParameters,
    preset_name: str,
) -> dict[str, Any]:
    """Return latency versus false alarms of both detectors, by speed, for JSON.

    Args:
        trials: Slips per speed.
        settings: Settings of the controller.
        preset_name: Difficulty preset of the sensors.
    """
    quiet = [
        _scored_quiet(name, k, settings, preset_name)
        for k in range(max(trials // 5, 1))
        for name in QUIET
    ]
    result: dict[str, Any] = {}
    for speed in SPEEDS_MM_S:
        slips = []
        for k in range(trials):
            # Windows lie on whole milliseconds; onsets lie anywhere between them.
            onset_s = LEARN_S + 1e-3 * (20.0 + k / trials)
            blocks = slip_blocks(speed, onset_s, SLIP_TRIAL_S, SLIP_SEED + k, preset_name)
            scored = _scored(list(windows_of(blocks, settings)), settings)
            slips.append((scored, round(1e6 * onset_s)))
        result[f'{speed:g}_mm_s'] = {each: _curve(each, slips, quiet) for each in DETECTORS}
    return result


def _scored_quiet(
    name: QuietName, number: int, settings: SlipControlParameters, preset_name: str
) -> ScoredTrial:
    blocks = quiet_blocks(name, LEARN_S + QUIET_TRIAL_S, QUIET_SEED + 100 + number, preset_name)
    return _scored(list(windows_of(blocks, settings)), settings)


def _scored(windows: list[Any], settings: SlipControlParameters) -> ScoredTrial:
    learning = round(1e6 * LEARN_S / settings.window_us)
    return score_trial(windows, learning, settings)


def _curve(
    detector: str, slips: list[tuple[ScoredTrial, int]], quiet: list[ScoredTrial]
) -> dict[str, Any]:
    curve = detector_curve(detector, slips, quiet)
    shipped = int(np.argmin(np.abs(np.log(curve.scale))))
    return {
        'auc': round(curve.auc, 4),
        'shipped': {
            'latency_p50_ms': _number(curve.latency_ms[shipped]),
            'latency_p99_ms': _number(curve.latency_p99_ms[shipped]),
            'false_alarms_per_min': round(float(curve.false_alarms_per_min[shipped]), 3),
            'missed': round(float(curve.missed[shipped]), 4),
        },
        'scale': [round(float(v), 4) for v in curve.scale],
        'false_alarms_per_min': [round(float(v), 3) for v in curve.false_alarms_per_min],
        'latency_ms': [_number(v) for v in curve.latency_ms],
        'missed': [round(float(v), 4) for v in curve.missed],
    }


def _number(value: float) -> float | None:
    """Return a latency for JSON, None for never."""
    return round(float(value), 3) if np.isfinite(value) else None
