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
from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_alignment.clock_fit import MAX_DRIFT
from mixtac_alignment.errors import DriftError, InconsistentFitError, RefinementError
from mixtac_alignment.gel_lag import COLUMNS, GelLag, LaggedForce
from mixtac_alignment.signals import smooth_force

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_alignment.clock_fit import ClockFit
    from mixtac_alignment.histories import FrameFeatures


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
LARGEST_STEP_S: Final = 4e-3
LARGEST_TURN: Final = 4e-4
BLOCK_S: Final = 1.0
"""Residuals this far apart are independent."""
INFLATION: Final = 1.6
"""Factor on the standard deviation, found on simulated trials: the static map errs slowly."""
FLOOR_S: Final = 1.1e-4
"""Error of the offset that no trial shows, found on simulated trials."""
FEWEST_FRAMES: Final = 120
LEAST_FORCE_N: Final = 0.02
JUMP_S: Final = 1.2e-3
JUMP_DEVIATIONS: Final = 10.0
"""A jump must be larger than this, and stand out of the noise by as much, to be one."""
LARGEST_MISFIT: Final = 0.08
"""Largest residual over the force's rms: 0.025 on simulated trials, 0.2 for wrong impulses."""
OUTLIER_TRUST: Final = 0.2
MOST_OUTLIERS: Final = 0.08
"""Largest share of frames beyond six standard deviations: 0.025 and 0.17."""
AGREEMENT: Final = 4.0
"""Standard deviations by which both fits may differ."""


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """A refined clock map.

    Attributes:
        fit: The map; anchors are those of the first fit, residuals are theirs to this map.
        lag: Lag of the gel, from the prior and this trial.
        residual_std: Force that frames and reference disagree by, robust standard deviation [N].
        lag_covariance: Covariance of the weights of the lag, 6 x 6.
    """

    fit: ClockFit
    lag: GelLag
    residual_std: float
    lag_covariance: NDArray[np.float64]


@dataclass(slots=True)
class _State:
    a: float
    b: float
    weights: NDArray[np.float64]
    trust: NDArray[np.float64]
    noise: float
    covariance: NDArray[np.float64]
    jump: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Known:
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
    prior = lag or GelLag()
    period = float(np.median(np.diff(force_t_s)))
    origin_s = first.reference_epoch_s
    even = np.arange(force_t_s[0] - origin_s, force_t_s[-1] - origin_s, period)
    force = smooth_force(np.interp(even, force_t_s - origin_s, force_N), period)
    lagged = LaggedForce(even, force)
    start_s, end_s = (_since(t, first.camera_epoch_us) for t in (frames.start_us, frames.end_us))
    inside = (first.a * start_s + first.b > even[0] + 0.03) & (
        first.a * end_s + first.b < even[-1] - 0.03
    )
    _require_enough(int(inside.sum()), force)
    start_s, end_s = start_s[inside], end_s[inside]
    state = _iterate(lagged, frames.values[inside], start_s, end_s, first, prior)
    _require_same_motion(state, float(force.std()))
    _require_no_jump(state.jump)
    return _checked(first, _result(first, state, prior))


def _iterate(
    lagged: LaggedForce,
    values: NDArray[np.float32],
    start_s: NDArray[np.float64],
    end_s: NDArray[np.float64],
    first: ClockFit,
    prior: GelLag,
) -> _State:
    """Take Gauss-Newton steps about the middle of the frames; return the state about the epoch."""
    t_s = 0.5 * (start_s + end_s)
    middle = float(t_s.mean())
    basis, slow = deformation_basis(values, t_s), slow_basis(t_s)
    state = _State(
        a=first.a,
        b=first.b + first.a * middle,
        weights=np.array(prior.mean),
        trust=np.ones(len(t_s)),
        noise=6e-3,
        covariance=np.zeros((2 + COLUMNS, 2 + COLUMNS)),
    )
    known = _knowledge(first, middle, prior)
    for count in range(STEPS):
        mean, slope = lagged.mean(
            state.a * (start_s - middle) + state.b, state.a * (end_s - middle) + state.b
        )
        _step(state, mean, slope, basis, slow, t_s - middle, known, last=count == STEPS - 1)
    turn = np.eye(2 + COLUMNS)
    turn[0, 1] = -middle
    state.b -= state.a * middle
    state.covariance = turn @ state.covariance @ turn.T
    return state


def _knowledge(first: ClockFit, middle_s: float, prior: GelLag) -> _Known:
    """Return what the first map and the prior of the gel say of b about the middle, a, weights."""
    mean = np.array([first.b + first.a * middle_s, first.a, *prior.mean])
    precision = np.diag([0.0, 0.0, *(1.0 / np.array(prior.std) ** 2)])
    about = np.array([[middle_s, 1.0], [1.0, 0.0]])
    impulses = np.linalg.inv(about @ first.covariance @ about.T)
    # Frames tell by so much less than their noise says.
    precision[:2, :2] = INFLATION**2 * impulses
    return _Known(mean, precision)


def _step(
    state: _State,
    mean: NDArray[np.float64],
    slope: NDArray[np.float64],
    basis: NDArray[np.float64],
    slow: NDArray[np.float64],
    t_s: NDArray[np.float64],
    known: _Known,
    *,
    last: bool,
) -> None:
    elastic = mean[:, 0] - mean[:, 1:] @ state.weights
    change = slope[:, 0] - slope[:, 1:] @ state.weights
    # Without this, weights could shrink the whole signal, and with it the residual.
    fast = elastic - slow @ (slow.T @ elastic)
    scale = (mean[:, 1:].T @ fast) / (fast @ fast)
    responses = mean[:, 1:] - np.outer(elastic, scale)
    design = np.column_stack([-change, -change * t_s, responses])
    root = np.sqrt(state.trust)
    q = np.linalg.qr(basis * root[:, None])[0]
    rows, target = design * root[:, None], elastic * root
    rows, target = rows - q @ (q.T @ rows), target - q @ (q.T @ target)
    before = state.noise**2 * known.precision
    now = np.array([state.b, state.a, *state.weights])
    normal = rows.T @ rows + before
    step = np.linalg.solve(normal, rows.T @ target + before @ (known.mean - now))
    residual = target - rows @ step
    _covariance(state, rows, residual, before, normal, t_s)
    free = max(1.0, len(t_s) - basis.shape[1] - 2.0) / len(t_s)
    if last:
        state.jump = largest_step(rows, residual, root * change, q, t_s, state.noise)
    plain = residual / np.maximum(root, 1e-3)
    state.noise = max(1e-5, 1.4826 * float(np.median(np.abs(plain))) / float(np.sqrt(free)))
    state.trust = 1.0 / (1.0 + (plain / (3.0 * state.noise)) ** 2)
    state.b += float(np.clip(step[0], -LARGEST_STEP_S, LARGEST_STEP_S))
    state.a += float(np.clip(step[1], -LARGEST_TURN, LARGEST_TURN))
    state.weights = state.weights + step[2:]


def _covariance(
    state: _State,
    rows: NDArray[np.float64],
    residual: NDArray[np.float64],
    before: NDArray[np.float64],
    normal: NDArray[np.float64],
    t_s: NDArray[np.float64],
) -> None:
    block = ((t_s - t_s[0]) / BLOCK_S).astype(np.int64)
    scores = np.zeros((int(block[-1]) + 1, rows.shape[1]))
    np.add.at(scores, block, rows * residual[:, None])
    inverse = np.linalg.inv(normal)
    spread = scores.T @ scores + state.noise**2 * before
    state.covariance = inverse @ spread @ inverse


def _result(first: ClockFit, state: _State, prior: GelLag) -> Refinement:
    covariance = INFLATION**2 * state.covariance[1::-1, 1::-1]
    covariance[1, 1] += FLOOR_S**2
    fit = replace(first, a=state.a, b=state.b, covariance=covariance, method='refined')
    camera_us = np.array([anchor.camera_us for anchor in first.anchors])
    reference_s = np.array([anchor.reference_s for anchor in first.anchors])
    fit = replace(fit, residuals_s=reference_s - fit.to_reference(camera_us))
    own = np.sqrt(np.diag(state.covariance)[2:])
    std = np.minimum(np.array(prior.std), np.maximum(own, 0.01))
    lag = GelLag(tuple(map(float, state.weights)), tuple(map(float, std)))
    weights = INFLATION**2 * state.covariance[2:, 2:]
    return Refinement(fit, lag, state.noise, weights)


def _checked(first: ClockFit, refined: Refinement) -> Refinement:
    if abs(refined.fit.a - 1.0) > MAX_DRIFT:
        raise DriftError(
            f'frames and force drift by {refined.fit.drift_ppm:.0f} ppm, working clocks by at most '
            f'{1e6 * MAX_DRIFT:.0f} ppm: a clock jumped or samples were lost; record again'
        )
    camera_us = np.array([anchor.camera_us for anchor in first.anchors])
    apart = refined.fit.to_reference(camera_us) - first.to_reference(camera_us)
    allowed = AGREEMENT * np.hypot(first.std_at(camera_us), refined.fit.std_at(camera_us))
    worst = int(np.argmax(np.abs(apart) - allowed))
    if abs(apart[worst]) > allowed[worst]:
        raise InconsistentFitError(
            f'impulses and frames disagree by {1e3 * abs(apart[worst]):.1f} ms, more than '
            f'{1e3 * allowed[worst]:.1f} ms: a clock jumped, samples were lost, or the taps are '
            'not the same ones; record again'
        )
    return refined


def _require_same_motion(state: _State, swing: float) -> None:
    strange = float(np.mean(state.trust < OUTLIER_TRUST))
    if state.noise > LARGEST_MISFIT * swing or strange > MOST_OUTLIERS:
        raise InconsistentFitError(
            f'frames explain the force to {state.noise:.3f} N of {swing:.3f} N rms, and '
            f'{100.0 * strange:.0f} % of them not at all: impulses were taken for each other, or '
            'taps are missing; record again with a tap at either end'
        )


def _require_no_jump(jump: tuple[float, float, float]) -> None:
    size_s, at_s, deviations = jump
    if abs(size_s) > JUMP_S and deviations > JUMP_DEVIATIONS:
        raise InconsistentFitError(
            f'one clock jumps by {1e3 * size_s:+.1f} ms about {at_s:+.1f} s from the middle of the '
            'recording: samples were lost or a clock was set; record again'
        )


def _since(t_us: NDArray[np.int64], epoch_us: int) -> NDArray[np.float64]:
    return (t_us - np.int64(epoch_us)).astype(np.float64) * 1e-6


def _require_enough(frames: int, force: NDArray[np.float64]) -> None:
    swing = float(np.percentile(force, 97.5) - np.percentile(force, 2.5))
    if frames < FEWEST_FRAMES or swing < LEAST_FORCE_N:
        raise RefinementError(
            f'{frames} frames under a force that varies by {swing:.3f} N: the refinement needs '
            f'{FEWEST_FRAMES} frames and {LEAST_FORCE_N:g} N; use the fit to impulses alone'
        )
