# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""The linear map from the camera clock to the reference clock, with its uncertainty.

The paper's relation (section Aligning Data) is :math:`t_F = a\,t_E + b`. At epoch times, 1.7e9 s, a
change of `a` by one ppb changes `b` by 1.7 s, so the rounding of one ruins the other. The fit is
therefore relative to two epochs near the middle of the anchors, all in seconds:

.. math:: t_F - T_F = a\,(t_E - T_E) + b

with :math:`T_E` (`camera_epoch_us`) and :math:`T_F` (`reference_epoch_s`) whole seconds, so that
differences to them are exact.

`ClockFit.to_fields` and `ClockFit.from_fields` convert a map to the fields of
`mixtac_msgs/ClockFit` and back; the node, bags and files use the same ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.errors import MixtacError


class AlignmentError(MixtacError):
    """Two recordings whose clocks cannot be aligned."""


class NoImpulseError(AlignmentError):
    """Fewer than two impulses in one of the recordings, or none that match."""


class AmbiguousImpulsesError(AlignmentError):
    """Impulses that match in more than one way."""


class SaturatedImpulseError(AlignmentError):
    """An impulse cut off by the range of the force sensor: its peak has no time."""


class ShortBaselineError(AlignmentError):
    """Anchors too close to each other for their uncertainty."""


class DriftError(AlignmentError):
    """A clock drift that no pair of working clocks has."""


class GapError(AlignmentError):
    """Data missing where they are needed, or a clock that jumped."""


F64 = NDArray[np.float64]

MAX_DRIFT: Final = 2e-4
"""Largest believable ``|a - 1|``: two uncompensated crystals differ by up to 1e-4."""
_LATEST_S: Final = 2.0**31
"""Times that fit into ROS stamps are nearer to zero [s]."""
_MAP = ('a', 'b', 'camera_epoch', 'reference_epoch')


@dataclass(frozen=True, slots=True)
class Anchor:
    """One physical moment on both clocks.

    Attributes:
        camera_us: Camera clock [us].
        reference_s: Reference clock [s].
        std_s: Standard deviation of the pairing [s], both sides together.
    """

    camera_us: int
    reference_s: float
    std_s: float


@dataclass(frozen=True, slots=True, eq=False)
class ClockFit:
    """A map from the camera clock to the reference clock.

    Attributes:
        a: Rate of the reference clock per camera clock.
        b: Offset about the epochs [s].
        covariance: 2 x 2, of (a, b) about the epochs; units [1, s; s, s^2].
        camera_epoch_us: Camera clock [us], a whole second.
        reference_epoch_s: Reference clock [s], a whole second.
        anchors: Anchors used, in the order of time.
        residuals_s: Per anchor, its reference time minus the fitted one [s].
        method: How the fit was made.
    """

    a: float
    b: float
    covariance: F64
    camera_epoch_us: int
    reference_epoch_s: float
    anchors: tuple[Anchor, ...]
    residuals_s: F64
    method: str

    def to_reference(self, t_us: int | NDArray[np.int64]) -> F64:
        """Return camera times [us] on the reference clock [s]."""
        return self.reference_epoch_s + (self.a * self.since_epoch_s(t_us) + self.b)

    def to_camera(self, t_s: float | F64) -> NDArray[np.int64]:
        """Return reference times [s] on the camera clock [us, rounded]."""
        seconds = (np.asarray(t_s, np.float64) - self.reference_epoch_s - self.b) / self.a
        return np.int64(self.camera_epoch_us) + np.rint(seconds * 1e6).astype(np.int64)

    def stamp_to_camera_us(self, stamp_ns: NDArray[np.int64]) -> F64:
        """Return stamps of the reference clock [ns] on the camera clock [us, not rounded]."""
        seconds = (stamp_ns - round(self.reference_epoch_s) * 1_000_000_000) / 1e9
        return np.asarray(self.camera_epoch_us + (seconds - self.b) / self.a * 1e6)

    def std_at(self, t_us: int | NDArray[np.int64]) -> F64:
        """Return the standard deviation [s] of `to_reference` at camera times [us]."""
        dt = self.since_epoch_s(t_us)
        c = self.covariance
        variance = c[0, 0] * dt**2 + 2.0 * c[0, 1] * dt + c[1, 1]
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    @property
    def residual_rms_s(self) -> float:
        """Root mean square of the residuals [s]; 0 for two anchors without a prior."""
        if not len(self.residuals_s):
            return 0.0
        return float(np.sqrt(np.mean(self.residuals_s**2)))

    @property
    def drift_ppm(self) -> float:
        """Drift of the reference clock against the camera clock [1e-6]."""
        return (self.a - 1.0) * 1e6

    def with_map(self, a: float, b: float, covariance: F64) -> ClockFit:
        """Return another map with the same epochs and anchors, with the residuals to this map.

        Args:
            a: Rate.
            b: Offset about the epochs [s].
            covariance: Of (a, b), 2 x 2.
        """
        fit = replace(self, a=a, b=b, covariance=covariance)
        camera_us = np.array([anchor.camera_us for anchor in self.anchors])
        reference_s = np.array([anchor.reference_s for anchor in self.anchors])
        return replace(fit, residuals_s=reference_s - fit.to_reference(camera_us))

    def summary(self) -> str:
        """Return a one-line summary."""
        if not self.anchors:
            return f'{self.method}: drift {self.drift_ppm:+.1f} ppm, no anchors'
        middle_us = self.anchors[0].camera_us // 2 + self.anchors[-1].camera_us // 2
        return (
            f'{len(self.anchors)} anchors over '
            f'{(self.anchors[-1].camera_us - self.anchors[0].camera_us) * 1e-6:.1f} s: drift '
            f'{self.drift_ppm:+.1f} +- {1e6 * float(np.sqrt(self.covariance[0, 0])):.1f} ppm, '
            f'+- {1e3 * float(self.std_at(middle_us)):.2f} ms in the middle, residual '
            f'{1e3 * self.residual_rms_s:.3f} ms rms'
        )

    def to_fields(self) -> dict[str, Any]:
        """Return the fields of `mixtac_msgs/ClockFit`, all but the header; times in seconds."""
        return {
            'a': self.a,
            'b': self.b,
            'covariance': self.covariance.ravel().tolist(),
            'camera_epoch': self.camera_epoch_us / 1_000_000,
            'reference_epoch': self.reference_epoch_s,
            'camera_anchors': [anchor.camera_us / 1_000_000 for anchor in self.anchors],
            'reference_anchors': [anchor.reference_s for anchor in self.anchors],
            'residuals': self.residuals_s.tolist(),
            'residual_rms': self.residual_rms_s,
            'method': self.method,
            'message': self.summary(),
        }

    @classmethod
    def from_fields(cls, fields: Mapping[str, Any]) -> ClockFit:
        """Return the map that fields describe.

        The map and its covariance come back exactly, the anchors rounded as float64 seconds are,
        with the uncertainty of the map instead of their own.

        Args:
            fields: Fields by name, as `to_fields` makes them.

        Raises:
            AlignmentError: The fields describe no map.
        """
        try:
            a, b, camera_s, reference_s = (float(fields[name]) for name in _MAP)
            covariance = np.array(fields['covariance'], np.float64).reshape(2, 2)
            anchors_s = [fields[name] for name in ('camera_anchors', 'reference_anchors')]
            pairs_s = np.array(anchors_s, np.float64).reshape(2, -1)
            residuals_s = np.array(fields['residuals'], np.float64).reshape(-1)
            method = str(fields['method'])
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise AlignmentError(f'clock fit: {error}', remedy='fit again') from error
        times = np.array([b, camera_s, reference_s, *pairs_s.flat])
        if (
            not (a > 0.0 and np.isfinite([a, *covariance.flat]).all())
            or not (np.abs(times) < _LATEST_S).all()
        ):
            raise AlignmentError(
                f'clock fit with a = {a} and b = {b} s is no map of clocks', remedy='fit again'
            )
        camera_us = round(camera_s * 1e6)
        fit = cls(a, b, covariance, camera_us, reference_s, (), residuals_s, method)
        at_us = [round(at_s * 1e6) for at_s in pairs_s[0].tolist()]
        stds = fit.std_at(np.array(at_us, np.int64)).tolist()
        return replace(fit, anchors=tuple(map(Anchor, at_us, pairs_s[1].tolist(), stds)))

    def since_epoch_s(self, t_us: int | NDArray[np.int64]) -> F64:
        """Return camera times [us] as seconds from the camera epoch."""
        since = np.asarray(t_us, np.int64) - np.int64(self.camera_epoch_us)
        return since.astype(np.float64) * 1e-6


def fit_clock(
    anchors: Sequence[Anchor],
    *,
    min_baseline_s: float = 1.0,
    max_drift: float = MAX_DRIFT,
    common_std_s: float = 0.0,
    drift_std: float = 0.0,
    method: str = '',
) -> ClockFit:
    """Fit the clock map to anchors: exactly for two, by weighted least squares for more.

    The covariance follows from the anchors' own standard deviations; where more than two anchors
    scatter by more than these, it grows with the scatter, and with what clocks stray from a line.

    Args:
        anchors: At least two, any order.
        min_baseline_s: Shortest time between the first and the last anchor [s].
        max_drift: Largest credible ``|a - 1|``, plus three standard deviations of `a`.
        common_std_s: Standard deviation of an error that all anchors share [s].
        drift_std: Prior standard deviation of ``a - 1``, which pulls an uncertain drift towards
            zero; 0 for no prior.
        method: Name of the method; empty for that of the solution.

    Raises:
        ShortBaselineError: All anchors within `min_baseline_s`.
        DriftError: The drift is not believable.
    """
    ordered = tuple(sorted(anchors, key=lambda anchor: anchor.camera_us))
    camera_us = [anchor.camera_us for anchor in ordered]
    baseline_s = (camera_us[-1] - camera_us[0]) * 1e-6
    if baseline_s < min_baseline_s or baseline_s <= 0.0:
        raise ShortBaselineError(
            f'anchors span {baseline_s:.3f} s, less than {min_baseline_s:g} s: tap once at the '
            'beginning and once at the end of the recording'
        )
    camera_epoch_us = sum(camera_us) // len(camera_us) // 1_000_000 * 1_000_000
    x = np.array([t - camera_epoch_us for t in camera_us], np.float64) * 1e-6
    reference = np.array([anchor.reference_s for anchor in ordered])
    reference_epoch_s = float(np.floor(reference.mean()))
    y = reference - reference_epoch_s
    std = np.array([anchor.std_s for anchor in ordered])
    (a, b), covariance = _solve(x, y, std)
    residuals = y - (a * x + b)
    if len(ordered) > 2:
        covariance *= max(1.0, float(np.sum((residuals / std) ** 2)) / (len(ordered) - 2))
        covariance[1, 1] += _stray_variance(residuals)
    covariance[1, 1] += common_std_s**2
    fit = ClockFit(
        a=a,
        b=b,
        covariance=covariance,
        camera_epoch_us=camera_epoch_us,
        reference_epoch_s=reference_epoch_s,
        anchors=ordered,
        residuals_s=residuals,
        method=method or ('two_impulse' if len(ordered) == 2 else 'least_squares'),
    )
    allowed = max_drift + 3.0 * float(np.sqrt(fit.covariance[0, 0]))
    if not abs(fit.a - 1.0) <= allowed:
        raise DriftError(
            f'clock drift of {fit.drift_ppm:.0f} ppm; working clocks stay within '
            f'{1e6 * allowed:.0f} ppm here: the anchors belong to different impulses, or samples '
            'were lost; record again with two sharp taps'
        )
    if drift_std <= 0.0:
        return fit
    gain = fit.covariance[:, 0] / (fit.covariance[0, 0] + drift_std**2)
    drift = fit.a - 1.0
    return fit.with_map(
        a=fit.a - float(gain[0]) * drift,
        b=fit.b - float(gain[1]) * drift,
        covariance=fit.covariance - np.outer(gain, fit.covariance[0]),
    )


def _stray_variance(residuals: F64) -> float:
    """Return the variance [s^2] that neighbours share beyond chance: more anchors do not lower it.

    The drift changes with the temperature, so that hours are no straight line.
    """
    shared = float(np.mean(residuals[1:] * residuals[:-1]))
    chance = 2.0 * float(np.mean(residuals**2)) / float(np.sqrt(len(residuals)))
    return max(shared - chance, 0.0)


def _solve(x: F64, y: F64, std: F64) -> tuple[tuple[float, float], F64]:
    """Return (a, b) and their covariance, solved about the weighted means for precision."""
    w = 1.0 / std**2
    x0, y0 = float(np.average(x, weights=w)), float(np.average(y, weights=w))
    if len(x) == 2:
        a = float((y[1] - y[0]) / (x[1] - x[0]))
    else:
        a = float(np.sum(w * (x - x0) * (y - y0)) / np.sum(w * (x - x0) ** 2))
    var_a = 1.0 / float(np.sum(w * (x - x0) ** 2))
    var_mean = 1.0 / float(np.sum(w))
    covariance = np.array([[var_a, -x0 * var_a], [-x0 * var_a, var_mean + x0**2 * var_a]])
    return (a, y0 - a * x0), covariance
