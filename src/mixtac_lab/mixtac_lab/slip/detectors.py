# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""False alarms and latency curves of the slip detectors on scenes with and without slip.

Thresholds are swept, so nothing is tuned on the evaluation data: a curve shows every threshold,
and the shipped one is a point on it. Scores are the quantities that the detectors compare with
their thresholds, in units of the background tail learned at the start of each trial.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from mixtac_lab.store import Piece, Store, code_version
from mixtac_sim.grasp.slip_scene import SceneBlock, SlipScene, knock_profile
from mixtac_sim.grids import STEP_US
from mixtac_sim.optics.scene import Flicker
from mixtac_sim.world.effects import preset
from mixtac_slip_control.detectors import CountDetector, Detectors, FlowDetector
from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.features import SlipFeatures, SlipWindow
from mixtac_slip_control.parameters import DETECTORS, SlipControlParameters

Floats = NDArray[np.float64]
SCALES = np.geomspace(0.02, 3.0, 60)
"""Thresholds of a curve, as multiples of the shipped one."""
HORIZON_US = 50_000
"""Detections later than this after the onset are misses [us]."""
REST_US = 5_000
"""Two crossings nearer than this are one alarm [us]."""
SPAN = 5
"""Windows of which the highest score counts for the area under the ROC curve."""


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


def score_trial(
    windows: Iterable[SlipWindow], learning: int, settings: SlipControlParameters
) -> ScoredTrial:
    """Return the scores of a trial.

    Args:
        windows: All windows of the trial; the first ones are at rest.
        learning: Fewest windows from which the detectors learn, more where a lamp hides some; they
            are not scored.
        settings: Settings of the detectors.

    Raises:
        SlipControlError: Too few windows to learn from.
    """
    by_count, by_flow = CountDetector(settings), FlowDetector(settings)
    rows = []
    for number, window in enumerate(windows):
        if window.light:
            continue  # as of `Detectors`
        by_count.update(window)
        by_flow.update(window)
        if number < learning or not (by_count.learned and by_flow.learned):
            by_count.learn(window)
            by_flow.learn(window)
        else:
            middle = by_count.background.median
            count = (window.count - middle) / (by_count.threshold - middle)
            rows.append((window.end_us, count, by_flow.flow / by_flow.threshold))
    if not rows:
        raise SlipControlError(
            f'{learning} windows or the whole trial do not suffice to learn the background',
            remedy='give as many windows as the settings require, with frames',
        )
    ends, counts, flows = zip(*rows, strict=True)
    return ScoredTrial(np.array(ends, np.int64), np.array(counts), np.array(flows))


def detector_curve(
    detector: str,
    slips: Sequence[tuple[ScoredTrial, int]],
    quiet: Sequence[ScoredTrial],
    scales: Floats = SCALES,
) -> dict[str, Any]:
    """Return latency versus false alarms of a detector, for JSON.

    Args:
        detector: `flow` or `count`.
        slips: Trials with slip and its onset, camera clock [us].
        quiet: Trials without slip, in which every onset of the detector is false.
        scales: Thresholds to try, as multiples of the shipped one.

    Returns:
        By threshold `scale`, reported onsets per minute without slip `false_alarms_per_min`, median
        time from onset to detection `latency_ms`, None where most are missed, and the share of
        trials without a detection `missed`; the same and the 99th percentile of the shipped
        threshold, `shipped`; `auc`, the probability that the highest score in the first windows of
        a slip exceeds that of as many windows without slip.

    Raises:
        SlipControlError: Nothing to evaluate, or an unknown detector.
    """
    if detector not in DETECTORS or not slips or not quiet:
        raise SlipControlError(
            f'detector {detector!r}, {len(slips)} trials with slip, {len(quiet)} without',
            remedy='give flow or count and at least one trial of each kind',
        )
    calm = [(trial.end_us, getattr(trial, detector)) for trial in quiet]
    minutes = sum(float(end[-1] - end[0]) for end, _ in calm) / 60e6
    alarms = [round(sum(_onsets(t, s > k) for t, s in calm) / minutes, 3) for k in scales]
    late = np.array([[_latency(trial, detector, on, k) for trial, on in slips] for k in scales])
    median, last = np.quantile(late, [0.5, 0.99], axis=1, method='higher')
    missed = np.mean(np.isinf(late), axis=1).round(4).tolist()
    shipped = int(np.argmin(np.abs(np.log(scales))))
    return {
        'auc': round(_auc(detector, slips, calm), 4),
        'shipped': {
            'latency_p50_ms': _number(median[shipped]),
            'latency_p99_ms': _number(last[shipped]),
            'false_alarms_per_min': alarms[shipped],
            'missed': missed[shipped],
        },
        'scale': scales.round(4).tolist(),
        'false_alarms_per_min': alarms,
        'latency_ms': [_number(value) for value in median],
        'missed': missed,
    }


def _onsets(times: NDArray[np.int64], above: NDArray[np.bool_]) -> int:
    hits = times[above]
    return 0 if len(hits) == 0 else 1 + int(np.count_nonzero(np.diff(hits) > REST_US))


def _latency(trial: ScoredTrial, detector: str, onset_us: int, threshold: float) -> float:
    """Return the time from the onset to the end of the first window above the threshold [ms]."""
    scores = getattr(trial, detector)
    first, last = np.searchsorted(trial.end_us, (onset_us, onset_us + HORIZON_US), side='right')
    found = np.flatnonzero(scores[first:last] > threshold)
    return float(trial.end_us[first + found[0]] - onset_us) * 1e-3 if len(found) else np.inf


def _auc(
    detector: str,
    slips: Sequence[tuple[ScoredTrial, int]],
    calm: Sequence[tuple[NDArray[np.int64], Floats]],
) -> float:
    """Return the area under the ROC curve of the maximum of `SPAN` scores."""
    from scipy.stats import mannwhitneyu

    positive = []
    for trial, onset in slips:
        first = int(np.searchsorted(trial.end_us, onset, side='right'))
        part = getattr(trial, detector)[first : first + SPAN]
        positive.append(part.max(initial=-np.inf))
    negative = np.concatenate(
        [s[: len(s) // SPAN * SPAN].reshape(-1, SPAN).max(axis=1) for _, s in calm]
    )
    # The statistic is the number of pairs in which the first is higher; half of the ties count.
    return float(mannwhitneyu(positive, negative).statistic / (len(positive) * len(negative)))


QuietName = Literal['hold', 'load', 'flicker', 'switched']
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
DARK = Flicker(0.0, 0.0, 0.0)
SWITCH_S = (0.1, 0.4)
"""Range of the time for which a lamp that is switched stays on, and off [s]."""
BLOCK_STEPS = 32


def quiet_blocks(
    name: QuietName, seconds: float, seed: int, preset_name: str
) -> Iterator[SceneBlock]:
    """Yield the sensor data of an object that does not slip, in blocks of 4 ms.

    Args:
        name: Steady hold, slow change of the load, a flickering lamp, or one that is switched on
            and off again and again.
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
    rng, lit, switch_s = np.random.default_rng([seed, 11]), False, LEARN_S
    for block in range(round(1e6 * seconds / (BLOCK_STEPS * STEP_US))):
        force = None
        if name == 'load':
            t = 1e-6 * STEP_US * (block * BLOCK_STEPS + np.arange(BLOCK_STEPS) + 1)
            turns = SWING_HZ[seed % len(SWING_HZ)] * t
            force = FORCE_N + SWING_N * 0.5 * (1.0 - np.cos(2.0 * np.pi * turns))
        if name == 'switched' and 1e-6 * STEP_US * BLOCK_STEPS * block >= switch_s:
            lit, switch_s = not lit, switch_s + rng.uniform(*SWITCH_S)
            scene.light_by(flicker_of(seed, rng.uniform()) if lit else DARK)
        yield scene.advance(still, force)


def flicker_of(seed: int, phase: float | None = None) -> Flicker:
    """Return the flicker of a scene, of any phase [turns]."""
    phase = (0.618 * seed) % 1.0 if phase is None else phase
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


def count_alarms(
    name: QuietName,
    seconds: float,
    preset_name: str,
    store: Store,
    console: Console,
    jobs: int = 1,
) -> dict[str, Any]:
    """Return the false alarms of both detectors with their shipped thresholds, for JSON.

    Args:
        name: Kind of scene.
        seconds: Simulated time without the learning [s].
        preset_name: Difficulty preset of the sensors.
        store: Stored results.
        console: Shows the progress.
        jobs: Number of processes.

    Returns:
        Kind of scene, `name`; simulated time after the background was learned, `seconds` [s];
        onsets that each detector reported, `flow` and `count`; `mean_count`, events per window;
        `saturated`, windows with a saturated sensor, which would stop an arm.
    """
    number = max(round(seconds / PIECE_S), 1)
    version = code_version('mixtac_events', 'mixtac_sim', 'mixtac_slip_control')
    arguments = [(name, k, seconds / number, preset_name) for k in range(number)]
    pieces = [Piece(f'quiet_{name}_{each[1]}', _quiet_piece, each, version) for each in arguments]
    found = store.run_shown(f'scene without slip: {name}', pieces, console, jobs)
    sums = {key: sum(each[key] for each in found) for key in found[0]}
    return {'name': name, **sums, 'mean_count': sums['mean_count'] / number}


def _quiet_piece(
    _base: Path, name: QuietName, number: int, seconds: float, preset_name: str
) -> dict[str, Any]:
    """Return the alarms of one sensor on one day, for JSON."""
    settings = SlipControlParameters()
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
    return {'seconds': seconds, **alarms, 'mean_count': mean, 'saturated': saturated}


def curves(trials: int, preset_name: str) -> dict[str, Any]:
    """Return latency versus false alarms of both detectors, by speed, for JSON.

    Args:
        trials: Slips per speed.
        preset_name: Difficulty preset of the sensors.
    """
    settings = SlipControlParameters()

    def scored(blocks: Iterator[SceneBlock]) -> ScoredTrial:
        learning = round(1e6 * LEARN_S / settings.window_us)
        return score_trial(windows_of(blocks, settings), learning, settings)

    quiet = [
        scored(quiet_blocks(name, LEARN_S + QUIET_TRIAL_S, QUIET_SEED + 100 + k, preset_name))
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
            slips.append((scored(blocks), round(1e6 * onset_s)))
        result[f'{speed:g}_mm_s'] = {each: detector_curve(each, slips, quiet) for each in DETECTORS}
    return result


def _number(value: float) -> float | None:
    """Return a latency for JSON, None for never."""
    return round(float(value), 3) if np.isfinite(value) else None
