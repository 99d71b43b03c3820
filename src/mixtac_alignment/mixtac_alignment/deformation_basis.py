# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a static map of the frames to a force can be: principal components and their products."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

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
