# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training curves as JSON and as a picture."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


def write_curves(folder: Path, curves: Sequence[dict[str, Any]]) -> None:
    """Write `curves.json` and `curves.png`.

    Args:
        folder: Made if need be.
        curves: One row per epoch: stage, epoch, loss, validation, seconds.
    """
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps({'epochs': list(curves)}, indent=1)
    (folder / 'curves.json').write_text(text + '\n', encoding='utf-8')
    draw_curves(folder / 'curves.png', curves)


def draw_curves(path: Path, curves: Sequence[dict[str, Any]]) -> None:
    """Draw loss and validation error [N] over the epochs, one panel per stage."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    stages = list(dict.fromkeys(row['stage'] for row in curves)) or ['none']
    figure = Figure(figsize=(4.0 * len(stages), 3.0), layout='constrained')
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(stages), squeeze=False)[0]
    for panel, stage in zip(panels, stages, strict=True):
        rows = [row for row in curves if row['stage'] == stage]
        epochs = [row['epoch'] for row in rows]
        panel.plot(epochs, [row['loss'] for row in rows], label='training loss')
        known = [(row['epoch'], row['validation']) for row in rows if row['validation'] is not None]
        if known:
            panel.plot(*zip(*known, strict=True), label='validation MAE')
        # The logarithm of a likelihood may be negative, and is no force.
        forces = all(row['loss'] > 0.0 for row in rows)
        scale, unit = ('log', 'N') if forces else ('linear', 'log likelihood, negative')
        panel.set(title=stage, xlabel='epoch', ylabel=unit, yscale=scale)
        panel.legend()
    figure.savefig(path, dpi=110)
