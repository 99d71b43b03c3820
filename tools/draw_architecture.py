#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Draw docs/images/architecture.svg: the nodes, what they exchange, and on which clock."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl

mpl.use('svg')
from matplotlib import pyplot as plt
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

OUTPUT = Path(__file__).resolve().parent.parent / 'docs' / 'images' / 'architecture.svg'
CAMERA, REFERENCE, HOST, PLAIN = '#0072b2', '#d55e00', '#555555', '#999999'
"""Colours of the three clocks, and of what has none."""


@dataclass(frozen=True)
class Box:
    """A node or a device.

    Attributes:
        x: Centre [drawing units], as `y`.
        y: Centre.
        title: Name.
        text: What it does.
        package: Package of the node; empty for others.
        device: Hardware, drawn dashed.
    """

    x: float
    y: float
    title: str
    text: str
    package: str = ''
    device: bool = False
    width: float = 2.5
    height: float = 1.0


BOXES = {
    'camera': Box(1.5, 5.0, 'DAVIS346', 'or virtual_sensor,\nor a recording', device=True),
    'ft': Box(1.5, 1.0, 'force sensor', 'or virtual_sensor', device=True),
    'driver': Box(5.6, 5.0, 'driver', 'USB, decoding,\n1 ms packets', 'mixtac_driver'),
    'fger': Box(10.0, 5.0, 'fger', '2 ms windows, frames,\nrecurrent network', 'mixtac_fger'),
    'alignment': Box(5.6, 1.0, 'alignment', 't_ref = a t_cam + b', 'mixtac_fger'),
    'slip': Box(10.0, 3.0, 'slip_control', 'counts per 1 ms,\nadvance', 'mixtac_slip_control'),
    'arm': Box(14.2, 3.0, 'arm', 'trajectory controller', device=True),
    'user': Box(14.2, 5.0, 'your node', 'control, learning', device=True),
    'view': Box(10.0, 1.0, 'view, recorder', 'everything, best effort', 'mixtac'),
}
ARROWS = (
    ('camera', 'driver', 'USB words', PLAIN, 0.22),
    ('driver', 'fger', 'events 1 kHz\nimage_raw 25 Hz', CAMERA, 0.1),
    ('fger', 'user', 'force 500 Hz', CAMERA, 0.15),
    ('driver', 'slip', 'events', CAMERA, 0.15),
    ('slip', 'arm', 'joint_trajectory', HOST, 0.15),
    ('ft', 'alignment', 'wrench 800 Hz', REFERENCE, 0.15),
    ('driver', 'alignment', 'events,\nimages,\nedges', CAMERA, 0.0),
    ('alignment', 'view', 'clock_fit', CAMERA, 0.15),
)


def anchor(box: Box, other: Box) -> tuple[float, float]:
    """Return the point on the rim of a box that faces another."""
    dx, dy = other.x - box.x, other.y - box.y
    if abs(dx) * box.height > abs(dy) * box.width:
        return box.x + (box.width / 2 if dx > 0 else -box.width / 2), box.y
    return box.x, box.y + (box.height / 2 if dy > 0 else -box.height / 2)


def draw() -> None:
    """Draw the picture and write it."""
    plt.rcParams.update({'svg.hashsalt': 'mixtac', 'svg.fonttype': 'path', 'font.size': 9})
    figure, axes = plt.subplots(figsize=(10, 4.3))
    for box in BOXES.values():
        axes.add_patch(
            FancyBboxPatch(
                (box.x - box.width / 2, box.y - box.height / 2),
                box.width,
                box.height,
                boxstyle='round,pad=0,rounding_size=0.15',
                facecolor='white' if box.device else '#eef4f8',
                edgecolor='#333333',
                linestyle='--' if box.device else '-',
            )
        )
        axes.text(box.x, box.y + 0.25, box.title, ha='center', va='center', weight='bold')
        axes.text(box.x, box.y - 0.16, box.text, ha='center', va='center', size=7.5)
        if box.package:
            axes.text(
                box.x - box.width / 2,
                box.y - box.height / 2 - 0.06,
                box.package,
                ha='left',
                va='top',
                size=6.5,
                color='#777777',
            )
    for source, target, text, colour, lift in ARROWS:
        start, end = anchor(BOXES[source], BOXES[target]), anchor(BOXES[target], BOXES[source])
        axes.add_patch(
            FancyArrowPatch(start, end, arrowstyle='-|>', mutation_scale=12, color=colour)
        )
        middle = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2 + lift)
        aside = source == 'driver' and target == 'alignment'
        axes.text(
            middle[0] - (0.12 if aside else 0.0),
            middle[1],
            text,
            ha='right' if aside else 'center',
            va='center' if aside else 'bottom',
            color=colour,
            size=7.5,
        )
    legend = ('camera clock', CAMERA), ('reference clock', REFERENCE), ('host clock', HOST)
    for i, (text, colour) in enumerate(legend):
        axes.text(12.95, 1.3 - 0.35 * i, text, color=colour, size=8)
    axes.set(xlim=(0, 15.7), ylim=(0.2, 5.8))
    axes.axis('off')
    figure.savefig(OUTPUT, bbox_inches='tight', pad_inches=0.05, metadata={'Date': None})


if __name__ == '__main__':
    draw()
