# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Style of the figures that commands draw, and saving them."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from mixtac_node.files import FileError, replacing

FORCE, REFERENCE, EVENTS, MARK = '#e07b00', '#1f4e8c', '#5a5a5a', '#c0392b'
"""Colours of the estimated force, the reference force, events, and marked moments or outliers."""
DPI = 110


def new_figure(width_in: float, height_in: float, title: str = '') -> Figure:
    """Return a figure of a size in inches. It needs no display.

    Args:
        width_in: Width.
        height_in: Height.
        title: Title; says that the data are simulated if they are.
    """
    figure = Figure(figsize=(width_in, height_in), layout='constrained')
    if title:
        figure.suptitle(title, x=0.01, ha='left', fontsize=11)
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Save a figure; the suffix of the path gives the format.

    Raises:
        FileError: The file cannot be written, or its suffix is not that of a format.
    """
    try:
        with replacing(path) as scratch:
            figure.savefig(scratch, dpi=DPI)
    except ValueError as error:
        raise FileError(
            f'cannot write {path}: {error}', remedy='name a .png or .pdf file'
        ) from error
