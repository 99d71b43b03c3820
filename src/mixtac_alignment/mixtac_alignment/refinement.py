# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""The clock map refined over the whole trial: frames against the reference force.

The frames, through a static map that is fitted at the same time, show the deformation of the gel at
exactly known times; the reference force, through the retarded responses of the gel (`gel_lag`),
gives the same deformation on its own clock. With the force as :math:`F`, the responses as
:math:`H_i` and a basis of functions of the frames as :math:`q`,

.. math:: \overline{F - \textstyle\sum w_i H_i}\,(a\,t + b) = q\,c + \text{noise},

averaged over each exposure, is solved for a, b and w by Gauss-Newton steps; c is eliminated by
projection. Residuals beyond three standard deviations lose weight (Cauchy). The first map and the
weights of the gel have priors. The covariance is that of a block bootstrap in closed form
(cluster-robust sandwich), since residuals of neighbouring frames are correlated, plus a floor found
on simulated trials. A jump of one clock within the recording shows in the residuals
(`largest_step`) and is refused.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixtac_alignment.clock_fit import MAX_DRIFT, ClockFit
from mixtac_alignment.errors import DriftError, InconsistentFitError, RefinementError
from mixtac_alignment.gel_lag import COLUMNS, GelLag, LaggedForce
from mixtac_alignment.histories import FrameFeatures
from mixtac_alignment.signals import even_force

COMPONENTS: Final = 14
"""Principal components of the log brightness."""
PRODUCTS: Final = 6
"""Components whose squares and products are taken too: brightness is not linear in the force."""
DRIFT_S: Final = 4.0
"""Half period of the fastest drift of force and light that is taken for drift [s]."""


def slow_basis(t_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return an orthonormal basis of a constant and slow drift, ``[n, k]``."""
    along = (t_s - t_s[0]) / (t_s[-1] - t_s[0])
    count = int(max(2.0, (t_s[-1] - t_s[0]) / DRIFT_S))
    return np.asarray(np.linalg.qr(np.cos(np.pi * np.outer(along, np.arange(count))))[0])


def deformation_basis(values: NDArray[np.float32], t_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return an orthonormal basis of functions of the frames, ``[n, k]``.

    Args:
        values: Log brightness, ``[n, cells]``.
        t_s: Time of each frame [s].
    """
    centred = values - values.mean(axis=0)
    left, size, _ = np.linalg.svd(centred, full_matrices=False)
    count = min(COMPONENTS, int(np.sum(size > 1e-6 * size[0])))
    parts = left[:, :count].astype(np.float64) * np.sqrt(len(left))
    few = min(PRODUCTS, count)
    columns = [*parts.T, *(parts[:, :2] ** 3).T]
    columns += [parts[:, i] * parts[:, j] for i in range(few) for j in range(i, few)]
    return np.asarray(np.linalg.qr(np.column_stack([slow_basis(t_s), *columns]))[0])


JUMP_SPACING_S: Final = 0.5
"""Spacing of the moments at which a jump is looked for [s]."""


def largest_step(
    rows: NDArray[np.float64],
    residual: NDArray[np.float64],
    change: NDArray[np.float64],
    basis: NDArray[np.float64],
    t_s: NDArray[np.float64],
    noise_N: float,
) -> tuple[float, float, float]:
    """Return the jump that would explain most of the residuals.

    Args:
        rows: Design of the fit, weighted and without what the basis explains, ``[n, p]``.
        residual: What the fit left, weighted, ``[n]`` [N].
        change: Weighted change of the force with time, ``[n]`` [N/s].
        basis: Orthonormal weighted basis, ``[n, k]``.
        t_s: Time of each frame [s].
        noise_N: Standard deviation of the residuals [N].

    Returns:
        Jump [s], when [s], and how many standard deviations it is.
    """
    own = np.linalg.qr(rows)[0]
    best = (0.0, float(t_s[0]), 0.0)
    for at in np.arange(t_s[0] + 1.0, t_s[-1] - 1.0, JUMP_SPACING_S):
        column = -change * (t_s > at)
        column -= basis @ (basis.T @ column)
        column -= own @ (own.T @ column)
        power = float(column @ column)
        if power < 1e-12:
            continue
        jump = float(column @ residual) / power
        deviations = abs(jump) * float(np.sqrt(power)) / noise_N
        if deviations > best[2]:
            best = (jump, float(at), deviations)
    return best


STEPS: Final = 12
"""Number of Gauss-Newton steps."""
LARGEST_OFFSET_STEP_S: Final = 4e-3
"""Largest change of the offset in one step [s]: as far as the first map may be wrong."""
LARGEST_RATE_STEP: Final = 4e-4
"""Largest change of the rate in one step: twice the largest believable drift."""
EDGE_MARGIN_S: Final = 0.03
"""Frames nearer to the ends of the force recording are left out [s]: three standard deviations of
the widest smoothing."""
FIRST_NOISE_N: Final = 6e-3
"""First guess of the noise of the force that frames show [N]; the steps estimate it."""
BLOCK_S: Final = 1.0
"""Residuals this far apart are independent [s]."""
INFLATION: Final = 1.6
"""Factor on the standard deviation, found on simulated trials: the static map errs slowly."""
FLOOR_S: Final = 1.1e-4
"""Error of the offset that no trial shows [s], found on simulated trials."""
FEWEST_FRAMES: Final = 120
"""Fewest frames that are refined with: more than the functions of the frames that are fitted."""
LEAST_FORCE_N: Final = 0.02
"""Least range of the force, from its 2.5 to its 97.5 percentile [N]."""
LEAST_LAG_STD: Final = 0.01
"""Least standard deviation of a weight of the gel after one trial."""
JUMP_S: Final = 1.2e-3
"""A jump of a clock must be larger than this to be one [s]."""
JUMP_DEVIATIONS: Final = 10.0
"""A jump of a clock must stand out of the noise by as many standard deviations to be one."""
LARGEST_MISFIT: Final = 0.08
"""Largest residual over the force's rms: 0.025 on simulated trials, 0.2 for wrong impulses."""
OUTLIER_TRUST: Final = 0.2
"""Cauchy weight below which a frame is an outlier: six standard deviations."""
MOST_OUTLIERS: Final = 0.08
"""Largest share of outliers: 0.025 on simulated trials, 0.17 for wrong impulses."""
AGREEMENT: Final = 4.0
"""Standard deviations by which both fits may differ."""


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """A refined clock map.

    Attributes:
        fit: The map; anchors are those of the first fit, residuals are theirs to this map.
        lag: Lag of the gel, from the prior and this trial.
        lag_covariance: Covariance of the weights of the lag, 6 x 6.
    """

    fit: ClockFit
    lag: GelLag
    lag_covariance: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class _Estimate:
    """One Gauss-Newton step's result, about the middle of the frames.

    Attributes:
        offset: b [s].
        rate: a.
        weights: Weights of the retarded responses, 6.
        trust: Cauchy weight of each frame, 0 to 1.
        noise: Robust standard deviation of the residuals [N].
        covariance: Covariance of (b, a, weights), 8 x 8.
        jump: Largest jump that the residuals allow: size [s], time [s], standard deviations.
    """

    offset: float
    rate: float
    weights: NDArray[np.float64]
    trust: NDArray[np.float64]
    noise: float
    covariance: NDArray[np.float64]
    jump: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def about(self, shift_s: float) -> _Estimate:
        """Return the same map about a time that is earlier by a shift [s]."""
        turn = np.eye(len(self.covariance))
        turn[0, 1] = -shift_s
        return replace(
            self,
            offset=self.offset - self.rate * shift_s,
            covariance=turn @ self.covariance @ turn.T,
        )


class _Prior(NamedTuple):
    """Mean and precision of (b, a, weights) before the frames are looked at."""

    mean: NDArray[np.float64]
    precision: NDArray[np.float64]


def refine(
    first: ClockFit,
    frames: FrameFeatures,
    force_t_s: NDArray[np.float64],
    force_N: NDArray[np.float64],
    lag: GelLag | None = None,
) -> Refinement:
    """Refine a clock map over the whole recording.

    Args:
        first: Map that is right to a few milliseconds, from impulses, with what is known of the
            drift in it (`clock_fit.with_drift_prior`).
        frames: Frames, camera clock.
        force_t_s: Force sample times, reference clock [s], increasing, evenly spaced.
        force_N: Normal force [N].
        lag: What is known of the gel; `GelLag` by default.

    Raises:
        RefinementError: Too few frames under a changing force.
        InconsistentFitError: The recording contradicts the first map.
        DriftError: The drift is not believable.
    """
    gel = lag or GelLag()
    even, force = even_force(force_t_s - first.reference_epoch_s, force_N)
    lagged = LaggedForce(even, force)
    start_s, end_s = first.since_epoch_s(frames.start_us), first.since_epoch_s(frames.end_us)
    inside = (first.a * start_s + first.b > even[0] + EDGE_MARGIN_S) & (
        first.a * end_s + first.b < even[-1] - EDGE_MARGIN_S
    )
    _require_enough(int(inside.sum()), force)
    start_s, end_s = start_s[inside], end_s[inside]
    t_s = 0.5 * (start_s + end_s)
    middle = float(t_s.mean())
    basis, slow = deformation_basis(frames.values[inside], t_s), slow_basis(t_s)
    prior = _prior(first, middle, gel)
    estimate = _Estimate(
        offset=first.b + first.a * middle,
        rate=first.a,
        weights=np.array(gel.mean),
        trust=np.ones(len(t_s)),
        noise=FIRST_NOISE_N,
        covariance=np.zeros((2 + COLUMNS, 2 + COLUMNS)),
    )
    for count in range(STEPS):
        mean, slope = lagged.mean(
            estimate.rate * (start_s - middle) + estimate.offset,
            estimate.rate * (end_s - middle) + estimate.offset,
        )
        last = count == STEPS - 1
        estimate = _step(estimate, mean, slope, basis, slow, t_s - middle, prior, last=last)
    estimate = estimate.about(middle)
    _require_same_motion(estimate, float(force.std()))
    _require_no_jump(estimate.jump)
    return _result(first, estimate, gel)


def _prior(first: ClockFit, middle_s: float, gel: GelLag) -> _Prior:
    """Return what the first map and the gel contribute, about the middle of the frames."""
    mean = np.array([first.b + first.a * middle_s, first.a, *gel.mean])
    precision = np.diag([0.0, 0.0, *(1.0 / np.array(gel.std) ** 2)])
    about = np.array([[middle_s, 1.0], [1.0, 0.0]])
    impulses = np.linalg.inv(about @ first.covariance @ about.T)
    # Residuals of the frames are correlated, so inflate their variance: the prior weighs more.
    precision[:2, :2] = INFLATION**2 * impulses
    return _Prior(mean, precision)


def _step(
    estimate: _Estimate,
    mean: NDArray[np.float64],
    slope: NDArray[np.float64],
    basis: NDArray[np.float64],
    slow: NDArray[np.float64],
    t_s: NDArray[np.float64],
    prior: _Prior,
    *,
    last: bool,
) -> _Estimate:
    """Return the estimate after one Gauss-Newton step; the last one looks for jumps as well."""
    elastic = mean[:, 0] - mean[:, 1:] @ estimate.weights
    change = slope[:, 0] - slope[:, 1:] @ estimate.weights
    # Without this, weights could shrink the whole signal, and with it the residual.
    fast = elastic - slow @ (slow.T @ elastic)
    scale = (mean[:, 1:].T @ fast) / (fast @ fast)
    responses = mean[:, 1:] - np.outer(elastic, scale)
    design = np.column_stack([-change, -change * t_s, responses])
    root_weight = np.sqrt(estimate.trust)
    q = np.linalg.qr(basis * root_weight[:, None])[0]
    rows, target = design * root_weight[:, None], elastic * root_weight
    rows, target = rows - q @ (q.T @ rows), target - q @ (q.T @ target)
    prior_precision = estimate.noise**2 * prior.precision
    present = np.array([estimate.offset, estimate.rate, *estimate.weights])
    normal = rows.T @ rows + prior_precision
    step = np.linalg.solve(normal, rows.T @ target + prior_precision @ (prior.mean - present))
    residual = target - rows @ step
    jump = estimate.jump
    if last:
        jump = largest_step(rows, residual, root_weight * change, q, t_s, estimate.noise)
    plain = residual / np.maximum(root_weight, 1e-3)
    freedom = max(1.0, len(t_s) - basis.shape[1] - 2.0) / len(t_s)
    noise = 1.4826 * float(np.median(np.abs(plain))) / float(np.sqrt(freedom))
    noise = max(1e-5, noise)
    # Cluster-robust covariance, with blocks of `BLOCK_S` as clusters.
    block = ((t_s - t_s[0]) / BLOCK_S).astype(np.int64)
    scores = np.zeros((int(block[-1]) + 1, rows.shape[1]))
    np.add.at(scores, block, rows * residual[:, None])
    inverse = np.linalg.inv(normal)
    spread = scores.T @ scores + estimate.noise**2 * prior_precision
    return _Estimate(
        offset=estimate.offset + _clipped(step[0], LARGEST_OFFSET_STEP_S),
        rate=estimate.rate + _clipped(step[1], LARGEST_RATE_STEP),
        weights=estimate.weights + step[2:],
        trust=1.0 / (1.0 + (plain / (3.0 * noise)) ** 2),
        noise=noise,
        covariance=inverse @ spread @ inverse,
        jump=jump,
    )


def _clipped(value: float, largest: float) -> float:
    return float(np.clip(value, -largest, largest))


def _result(first: ClockFit, estimate: _Estimate, gel: GelLag) -> Refinement:
    covariance = INFLATION**2 * estimate.covariance[1::-1, 1::-1]
    covariance[1, 1] += FLOOR_S**2
    fit = first.with_map(estimate.rate, estimate.offset, covariance, 'refined')
    own = np.sqrt(np.diag(estimate.covariance)[2:])
    std = np.minimum(np.array(gel.std), np.maximum(own, LEAST_LAG_STD))
    lag = GelLag(tuple(map(float, estimate.weights)), tuple(map(float, std)))
    if abs(fit.a - 1.0) > MAX_DRIFT:
        raise DriftError(
            f'frames and force drift by {fit.drift_ppm:.0f} ppm, working clocks by at most '
            f'{1e6 * MAX_DRIFT:.0f} ppm: a clock jumped or samples were lost; record again'
        )
    camera_us = np.array([anchor.camera_us for anchor in first.anchors])
    apart = fit.to_reference(camera_us) - first.to_reference(camera_us)
    allowed = AGREEMENT * np.hypot(first.std_at(camera_us), fit.std_at(camera_us))
    worst = int(np.argmax(np.abs(apart) - allowed))
    if abs(apart[worst]) > allowed[worst]:
        raise InconsistentFitError(
            f'impulses and frames disagree by {1e3 * abs(apart[worst]):.1f} ms, more than '
            f'{1e3 * allowed[worst]:.1f} ms: a clock jumped, samples were lost, or the taps are '
            'not the same ones; record again'
        )
    return Refinement(fit, lag, INFLATION**2 * estimate.covariance[2:, 2:])


def _require_same_motion(estimate: _Estimate, swing: float) -> None:
    outliers = float(np.mean(estimate.trust < OUTLIER_TRUST))
    if estimate.noise > LARGEST_MISFIT * swing or outliers > MOST_OUTLIERS:
        raise InconsistentFitError(
            f'frames explain the force to {estimate.noise:.3f} N of {swing:.3f} N rms, and '
            f'{100.0 * outliers:.0f} % of them not at all: impulses were mistaken for each other, '
            'or taps are missing',
            remedy='record again with a tap at either end',
        )


def _require_no_jump(jump: tuple[float, float, float]) -> None:
    size_s, at_s, deviations = jump
    if abs(size_s) > JUMP_S and deviations > JUMP_DEVIATIONS:
        raise InconsistentFitError(
            f'one clock jumps by {1e3 * size_s:+.1f} ms about {at_s:+.1f} s from the middle of the '
            'recording: samples were lost or a clock was set; record again'
        )


def _require_enough(frames: int, force: NDArray[np.float64]) -> None:
    swing = float(np.percentile(force, 97.5) - np.percentile(force, 2.5))
    if frames < FEWEST_FRAMES or swing < LEAST_FORCE_N:
        raise RefinementError(
            f'{frames} frames under a force that varies by {swing:.3f} N: the refinement needs '
            f'{FEWEST_FRAMES} frames and {LEAST_FORCE_N:g} N; use the fit to impulses alone'
        )
