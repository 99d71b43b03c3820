# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures of a demo: computed from its bag and from what was measured live, drawn, and printed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from mixtac.figures import EVENTS, FORCE, REFERENCE, make_table, new_figure, save_figure
from mixtac_core.events.codec import decode_message
from mixtac_core.events.sequence import SequenceCounter
from mixtac_core.events.windows import counts_per_window
from mixtac_core.node import topics
from mixtac_core.node.stamps import stamp_to_ns
from mixtac_core.recordings.bag import BagFile
from mixtac_fger.alignment.align import align
from mixtac_fger.alignment.bags import read_recording
from mixtac_fger.alignment.clock_fit import ClockFit
from mixtac_fger.alignment.errors import AlignmentError
from mixtac_sim.mechanics.contact import Mode
from mixtac_sim.world.profiles import make_profile
from mixtac_sim.world.segments import Segment

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BAG: Final = 'bag'
WINDOW_NS: Final = 2_000_000
"""Time between two forces [ns]."""
RATE_WINDOW_US: Final = 10_000
"""Window in which event rates are counted [us]."""
MAX_FORCE_GAP_S: Final = 2.0
"""A busy host may lose reference samples [s]; here their clock is known to be a single one."""
EDGE_US: Final = 50_000
"""Half a synchronising impulse [us]: the comparison starts and ends with whole impulses."""
NEAR_US: Final = 100_000
"""The rest without a load begins this long after the first impulse [us]."""
FAR_US: Final = 500_000
"""It ends this long after the first impulse [us]; the other rest lies as far before the last."""
TREMOR_N: Final = 0.05
"""Amplitude above which a press counts as an oscillation [N]."""
HELD_PART: Final = 0.8
"""Part of the largest force of the press above which it is held; this calibrates."""
PRESS, OSCILLATION, IMPACT = 'press and hold', 'oscillation', 'impact of a dropped weight'
SHOWN_S: Final = {PRESS: 60.0, OSCILLATION: 3.0, IMPACT: 0.8}
"""Longest time of each part that the figure enlarges [s]."""

ALIGNED: Final = (
    *('mae_n', 'rmse_n', 'mae_uncalibrated_n', 'constant_mae_n', 'gain', 'reference_zero_n'),
    *('clock_drift_ppm', 'aligned_by'),
)
"""Figures that are None where the alignment was refused."""
I64 = NDArray[np.int64]
F64 = NDArray[np.float64]
Spans = dict[str, tuple[float, float]]


@dataclass(frozen=True)
class Run:
    """What was measured while the graph ran.

    Attributes:
        dropped: Transfers, words, frames and messages that nodes dropped.
        computed_s: Time for which simulated time stopped to compute the scenario [s].
        waited_s: Time for which it stopped later [s].
        arrival_ns: Arrival of each force, host clock [ns], int64.
        stamp_ns: Stamp of each force, camera clock [ns], int64.
    """

    dropped: int
    computed_s: float
    waited_s: float
    arrival_ns: I64
    stamp_ns: I64


@dataclass(frozen=True)
class Streams:
    """The streams of a recorded run.

    Attributes:
        event_t_us: Event times, camera clock [us], int64.
        lost_packets: Event packets missing by their sequence numbers.
        complete_us: Time up to which each event packet is complete, camera clock [us], int64.
        arrival_ns: Arrival of each event packet at the host [ns], int64.
        invalid: Forces that are marked as not valid.
        force_ns: Ends of the force windows, camera clock [ns], int64.
        force_n: Estimated normal force [N].
        reference_ns: Stamps of the reference, reference clock [ns], int64.
        reference_n: Reference normal force [N].
    """

    event_t_us: I64
    lost_packets: int
    complete_us: I64
    arrival_ns: I64
    invalid: int
    force_ns: I64
    force_n: F64
    reference_ns: I64
    reference_n: F64


@dataclass(frozen=True)
class Comparison:
    """Estimate against reference, on the camera clock.

    Attributes:
        fit: The clock fit that brought the reference to the camera clock.
        start_us: Camera clock at time 0 below [us].
        time_s: Sample times [s].
        estimate_n: Estimated force before the calibration [N].
        reference_n: Reference force at the same times, less its zero [N].
        zeros_n: Zero of the reference after the first and before the last impulse [N].
        gain: Factor of the force, by which the press is held at the force of the reference.
        judged: Which samples count for the errors: all but those of the press.
    """

    fit: ClockFit
    start_us: int
    time_s: F64
    estimate_n: F64
    reference_n: F64
    zeros_n: tuple[float, float]
    gain: float
    judged: NDArray[np.bool_]

    def mae(self, gain: float) -> float:
        """Return the mean absolute error of the estimate times a gain [N]."""
        return float(np.abs(gain * self.estimate_n - self.reference_n)[self.judged].mean())

    def figures(self) -> dict[str, Any]:
        """Return the figures of the comparison; see `evaluate`."""
        reference = self.reference_n[self.judged]
        error = self.gain * self.estimate_n[self.judged] - reference
        return {
            'mae_n': self.mae(self.gain),
            'rmse_n': float(np.sqrt((error**2).mean())),
            'mae_uncalibrated_n': self.mae(1.0),
            'gain': self.gain,
            'reference_zero_n': self.zeros_n,
            'constant_mae_n': float(np.abs(reference - np.median(reference)).mean()),
            'clock_drift_ppm': self.fit.drift_ppm,
            'aligned_by': self.fit.method,
        }


def evaluate(out: Path, run: Run, seconds: float, seed: int, device_seed: int) -> dict[str, Any]:
    """Compare the recorded force with the aligned reference, and draw the run.

    Returns:
        The figures for JSON; simulated sensor, real processes and middleware.

        `seconds`: Length of the scenario [s].
        `seed`: Seed of the scenario.
        `device_seed`: Seed of the virtual sensor's build.
        `force_hz`: Rate of `/mixtac/force` at a subscriber in another process.
        `lost`: Force samples missing at that subscriber, by their stamps.
        `invalid`: Force samples marked as not valid; they are published and count in all figures.
        `latency_ms`: From the arrival of the last packet of a window to its force at the
            subscriber, p50 and p99.
        `gain`: Factor of the force by which the press of the scenario calibrates the sensor; None,
            as the figures from here to `aligned_by`, if the alignment was refused.
        `mae_n`: Mean absolute error of the calibrated force against the reference, aligned as by
            `mixtac align` and less its zero, without the press that calibrates.
        `rmse_n`: Root mean square error of the same samples.
        `mae_uncalibrated_n`: Mean absolute error of the same samples without the calibration.
        `constant_mae_n`: Error of the best constant guess on the same samples.
        `reference_zero_n`: What the reference showed without a load, before and after [N].
        `clock_drift_ppm`: Drift of the reference clock found by the alignment.
        `aligned_by`: Method of the alignment.
        `event_rate_mev_s`: Mean event rate.
        `peak_event_rate_mev_s`: Highest event rate in 10 ms.
        `packet_hz`: Rate of event packets.
        `lost_packets`: Event packets missing in the recording.
        `computed_s`: Time for which simulated time stopped to compute the scenario [s].
        `waited_s`: Time for which it stopped later, because the host was too slow [s].
        `dropped`: Transfers, words, frames and messages dropped inside nodes.
        `refused`: Why the alignment was refused, or empty.
    """
    streams = read_streams(out / BAG, topics.DEFAULT_NAMESPACE)
    spans = phases(seconds, seed)
    comparison, refused = None, ''
    try:
        fit = align(read_recording(out / BAG), max_gap_s=MAX_FORCE_GAP_S)
        comparison = compare(streams, fit, spans[PRESS])
    except AlignmentError as error:
        refused = str(error)
    latency = latency_ms(streams, run)
    rate = event_rate(streams, comparison)
    report: dict[str, Any] = {
        'seconds': seconds,
        'seed': seed,
        'device_seed': device_seed,
        'force_hz': float((len(latency) - 1) * 1e9 / np.ptp(run.arrival_ns)),
        'lost': lost_windows(run.stamp_ns),
        'invalid': streams.invalid,
        'latency_ms': {
            'p50': float(np.quantile(latency, 0.5)),
            'p99': float(np.quantile(latency, 0.99)),
        },
        **(comparison.figures() if comparison else dict.fromkeys(ALIGNED)),
        'event_rate_mev_s': float(rate.mean() / 1e6),
        'peak_event_rate_mev_s': float(rate.max() / 1e6),
        'packet_hz': len(streams.complete_us) / (np.ptp(streams.force_ns) / 1e9),
        'lost_packets': streams.lost_packets,
        'computed_s': run.computed_s,
        'waited_s': run.waited_s,
        'dropped': run.dropped,
        'refused': refused,
    }
    if comparison is not None:
        title = (
            f'Virtual sensor (simulated), seed {seed}: MAE {report["mae_n"]:.3f} N against the '
            f'aligned reference, {report["force_hz"]:.1f} Hz, {report["lost"]} lost'
        )
        draw_run(out / 'demo.png', comparison, rate, spans, title)
    return report


def read_streams(path: Path, namespace: str) -> Streams:
    """Read the streams of a virtual sensor from a bag.

    Raises:
        RecordingError: A topic is missing or the bag is damaged.
    """
    times, complete_us, arrival_ns = [np.empty(0, np.int64)], [], []
    events, quality = (each.resolved(namespace) for each in (topics.EVENTS, topics.FORCE_QUALITY))
    counter, invalid = SequenceCounter(), 0
    with BagFile(path) as bag:
        for topic, _, message in bag.messages(events, quality):
            if topic == quality:
                invalid += not message.valid
                continue
            counter.update(message.seq)
            packet = decode_message(message)
            times.append(packet.events.t)
            complete_us.append(packet.complete_until)
            arrival_ns.append(stamp_to_ns(message.header.stamp))
        force_ns, force = bag.wrenches(topics.FORCE.resolved(namespace))
        reference_ns, reference = bag.wrenches(topics.REFERENCE)
    return Streams(
        event_t_us=np.concatenate(times),
        lost_packets=counter.lost,
        complete_us=np.array(complete_us, np.int64),
        arrival_ns=np.array(arrival_ns, np.int64),
        invalid=invalid,
        force_ns=force_ns,
        force_n=force[:, 2],
        reference_ns=reference_ns,
        reference_n=reference[:, 2],
    )


def compare(streams: Streams, fit: ClockFit, press_s: tuple[float, float]) -> Comparison:
    """Bring the reference to the camera clock, calibrate by the press, and compare.

    Samples from the first to the last impulse of the fit count, the impulses included. The zero of
    a reference sensor drifts. As on a bench it is measured without a load, before and after;
    between the two it follows a straight line.

    Args:
        streams: The streams of the run.
        fit: Clock fit of the reference.
        press_s: Start and end of the press [s], as from `phases`.
    """
    reference_us = fit.to_camera(streams.reference_ns / 1e9)
    force_us = streams.force_ns // 1000
    first_us, last_us = fit.anchors[0].camera_us, fit.anchors[-1].camera_us
    rests = (first_us + NEAR_US, first_us + FAR_US), (last_us - FAR_US, last_us - NEAR_US)
    before, after = (
        float(streams.reference_n[(reference_us >= start) & (reference_us <= end)].mean())
        for start, end in rests
    )
    zero = np.interp(reference_us, np.mean(rests, axis=1), (before, after))
    start_us = first_us - EDGE_US
    inside = (force_us >= start_us) & (force_us <= last_us + EDGE_US)
    reference = np.interp(force_us[inside], reference_us, streams.reference_n - zero)
    time_s, estimate = (force_us[inside] - start_us) / 1e6, streams.force_n[inside]
    pressed = (time_s >= press_s[0]) & (time_s <= press_s[1])
    held = pressed & (reference > HELD_PART * reference[pressed].max(initial=0.0))
    return Comparison(
        fit=fit,
        start_us=start_us,
        time_s=time_s,
        estimate_n=estimate,
        reference_n=reference,
        zeros_n=(before, after),
        gain=float(reference[held].sum() / estimate[held].sum()) if held.any() else 1.0,
        judged=~pressed,
    )


def lost_windows(stamps_ns: I64) -> int:
    """Return how many 2 ms windows are missing between the first and the last stamp."""
    if len(stamps_ns) == 0:
        return 0
    return int((stamps_ns[-1] - stamps_ns[0]) // WINDOW_NS) + 1 - len(stamps_ns)


def latency_ms(streams: Streams, run: Run) -> F64:
    """Return the time from the arrival of a window's last packet to its force [ms].

    The end of the window itself has no time on the host clock where simulated time stops.
    """
    packet = np.searchsorted(streams.complete_us * 1000, run.stamp_ns)
    sent_ns = streams.arrival_ns[packet.clip(max=len(streams.arrival_ns) - 1)]
    return np.asarray((run.arrival_ns - sent_ns) / 1e6, np.float64)


def event_rate(streams: Streams, comparison: Comparison | None) -> F64:
    """Return event rates in windows of 10 ms [1/s] over the comparison; without one over all."""
    if comparison is None:
        start_us, end_us = int(streams.force_ns[0]) // 1000, int(streams.force_ns[-1]) // 1000
    else:
        start_us = comparison.start_us
        end_us = start_us + int(comparison.time_s[-1] * 1e6)
    counts = counts_per_window(streams.event_t_us, start_us, end_us, RATE_WINDOW_US)
    return np.asarray(counts * (1e6 / RATE_WINDOW_US), np.float64)


def phases(seconds: float, seed: int) -> Spans:
    """Return start and end of each part of the scenario [s, as in the comparison].

    The comparison starts at the first synchronising impulse, whose time the profile holds.

    Args:
        seconds: Length of the scenario [s].
        seed: Its seed.
    """
    profile = make_profile('demo', seed, seconds, sync=True)
    first_s, last_s = profile.sync_s
    origin_s = first_s - EDGE_US / 1e6
    spans: Spans = {}
    for each in profile.segments:
        if first_s < each.start_s and each.end_s < last_s:
            start_s = spans.get(_name(each), (each.start_s - origin_s, 0.0))[0]
            spans[_name(each)] = (start_s, each.end_s - origin_s)
    return spans


def _name(segment: Segment) -> str:
    if segment.mode >= Mode.DROP:
        return IMPACT
    return OSCILLATION if segment.tones and segment.tones[0].amplitude > TREMOR_N else PRESS


def draw_run(path: Path, comparison: Comparison, rate: F64, spans: Spans, title: str) -> None:
    """Save a figure of a run.

    Args:
        path: File to write; its suffix gives the format.
        comparison: Estimate and aligned reference.
        rate: Event rates [1/s] in windows of 10 ms from the start of the comparison.
        spans: Parts to show enlarged, from `phases`.
        title: Title; says that the data are simulated if they are.

    Raises:
        FileError: The file cannot be written.
    """
    figure = new_figure(11, 8.5)
    grid = figure.add_gridspec(4, len(spans), height_ratios=[3, 1, 1, 3])
    whole = figure.add_subplot(grid[0, :])
    _draw_force(whole, comparison, 0.0, float(comparison.time_s[-1]))
    whole.set_ylim(-0.15, max(1.2, 1.3 * float(np.quantile(comparison.reference_n, 0.99))))
    whole.legend(loc='upper right', ncols=2, frameon=False)
    whole.set_title(title, loc='left')
    error = figure.add_subplot(grid[1, :], sharex=whole)
    difference_n = comparison.gain * comparison.estimate_n - comparison.reference_n
    error.plot(comparison.time_s, difference_n, color=FORCE, lw=0.7)
    error.axhline(0, color='k', lw=0.5)
    error.set(ylabel='error [N]', ylim=(-0.5, 0.5))
    events = figure.add_subplot(grid[2, :], sharex=whole)
    centres_s = (np.arange(len(rate)) + 0.5) * RATE_WINDOW_US / 1e6
    events.semilogy(centres_s, np.maximum(rate, 1.0), color=EVENTS, lw=0.8)
    events.set(xlabel='camera time [s]', ylabel='events [1/s]')
    for column, (name, (start_s, end_s)) in enumerate(spans.items()):
        axes = figure.add_subplot(grid[3, column])
        _draw_force(axes, comparison, start_s, min(end_s, start_s + SHOWN_S[name]))
        axes.set_title(f'{name} (calibrates)' if name == PRESS else name, fontsize=10)
        axes.set_xlabel('camera time [s]')
    save_figure(figure, path)


def _draw_force(axes: Axes, comparison: Comparison, start_s: float, end_s: float) -> None:
    shown = (comparison.time_s >= start_s) & (comparison.time_s <= end_s)
    time_s, estimate = comparison.time_s[shown], comparison.gain * comparison.estimate_n[shown]
    axes.plot(time_s, comparison.reference_n[shown], color=REFERENCE, lw=1.4, label='reference')
    axes.plot(time_s, estimate, color=FORCE, lw=1.0, label='estimate')
    axes.set(ylabel='normal force [N]', xlim=(start_s, end_s))
    axes.grid(visible=True, alpha=0.25)


def print_summary(console: Console, report: Mapping[str, Any], folder: Path) -> None:
    """Print the results of a demo and where its bag and figure are."""
    title = 'Measured on the virtual sensor (simulated)'
    console.print(make_table(title, ('figure', 'value'), _rows(report)))
    if report['refused']:
        console.print(f'no error and no figure: {report["refused"]}', soft_wrap=True)
    else:
        console.print(f'figure   {folder / "demo.png"}', soft_wrap=True)
    console.print(f'bag      {folder / BAG}', soft_wrap=True)
    console.print(f'summary  {folder / "demo.json"}', soft_wrap=True)


def _rows(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    def n(key: str) -> str:
        return '-' if report[key] is None else f'{report[key]:.3f}'

    latency = report['latency_ms']
    return [
        ('event rate, mean', f'{n("event_rate_mev_s")} Mev/s'),
        ('event rate, highest in 10 ms', f'{n("peak_event_rate_mev_s")} Mev/s'),
        ('force', f'{report["force_hz"]:.1f} Hz'),
        ('latency p50 / p99', f'{latency["p50"]:.2f} / {latency["p99"]:.2f} ms'),
        ('gain, calibrated by the press', n('gain')),
        ('error against the reference, MAE / RMSE', f'{n("mae_n")} / {n("rmse_n")} N'),
        ('  before the calibration, MAE', f'{n("mae_uncalibrated_n")} N'),
        ('  best constant guess, MAE', f'{n("constant_mae_n")} N'),
        ('drift of the reference clock', f'{n("clock_drift_ppm")} ppm'),
        ('lost force samples', str(report['lost'])),
        ('lost event packets', str(report['lost_packets'])),
        ('forces marked as not valid', str(report['invalid'])),
        ('dropped inside nodes', str(report['dropped'])),
        ('simulated time stopped for a slow host', f'{report["waited_s"]:.2f} s'),
    ]
