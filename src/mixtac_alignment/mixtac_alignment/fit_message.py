# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A clock map as the fields of `mixtac_msgs/ClockFit`, both ways, live and in bags."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mixtac_alignment.clock_fit import Anchor, ClockFit
from mixtac_alignment.errors import AlignmentError

if TYPE_CHECKING:
    from collections.abc import Mapping


def to_fields(fit: ClockFit) -> dict[str, Any]:
    """Return the message fields of a fit, all but the header; times in seconds."""
    return {
        'a': fit.a,
        'b': fit.b,
        'covariance': fit.covariance.ravel().tolist(),
        'camera_epoch': fit.camera_epoch_us / 1_000_000,
        'reference_epoch': fit.reference_epoch_s,
        'camera_anchors': [anchor.camera_us / 1_000_000 for anchor in fit.anchors],
        'reference_anchors': [anchor.reference_s for anchor in fit.anchors],
        'residuals': fit.residuals_s.tolist(),
        'residual_rms': fit.residual_rms_s,
        'method': fit.method,
        'message': fit.summary(),
    }


def from_fields(fields: Mapping[str, Any]) -> ClockFit:
    """Return the fit that a message describes.

    The map and its covariance come back exactly, the anchors rounded as float64 seconds are, and
    with the fit's own uncertainty there in place of theirs.

    Args:
        fields: Fields by name, as `to_fields` makes them.

    Raises:
        AlignmentError: The fields describe no map.
    """
    covariance = np.array(fields['covariance'], np.float64).reshape(2, 2)
    epoch_us = round(fields['camera_epoch'] * 1e6)
    if not fields['a'] > 0.0 or not np.isfinite([fields['a'], fields['b'], *covariance.flat]).all():
        raise AlignmentError(
            f'clock fit with a = {fields["a"]}, b = {fields["b"]} is no map of clocks: fit again'
        )
    anchors = zip(fields['camera_anchors'], fields['reference_anchors'], strict=True)
    bare = ClockFit(
        a=float(fields['a']),
        b=float(fields['b']),
        covariance=covariance,
        camera_epoch_us=epoch_us,
        reference_epoch_s=float(fields['reference_epoch']),
        anchors=(),
        residuals_s=np.array(fields['residuals'], np.float64),
        method=str(fields['method']),
    )
    return bare.with_anchors(
        Anchor(round(c * 1e6), float(r), float(bare.std_at(round(c * 1e6)))) for c, r in anchors
    )
