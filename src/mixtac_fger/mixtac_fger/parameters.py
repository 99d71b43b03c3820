# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the force estimator node."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_fger.weights import DEFAULT_MODEL
from mixtac_node.parameters import parameter


@dataclass(frozen=True)
class FgerParameters:
    """What the node can be told; changes apply at the next configure."""

    model: str = parameter(
        DEFAULT_MODEL,
        'Network weights: the path of a .safetensors file, or the name of a model that comes with'
        ' mixtac_fger.',
    )
    frame_id: str = parameter(
        'mixtac_contact', 'Frame of the published force: z points from the contact into the gel.'
    )
    force_scale: float = parameter(
        1.0,
        'True force over estimated force of this very sensor, from its calibration: gels differ in'
        ' stiffness, which no image shows.',
        minimum=0.1,
        maximum=10.0,
    )
    reference: str = parameter(
        '',
        'File of the no-contact reference of this sensor (.npz). ~/tare writes it; where it exists,'
        ' estimating may begin in contact. Empty: the first still frames are the reference, so that'
        ' the sensor has to be untouched when the node is activated.',
    )
    contact_threshold: float = parameter(
        0.15,
        'Forces above this count as contact, in which ~/tare refuses.',
        unit='N',
        minimum=0.01,
        maximum=10.0,
    )
    stale_frame_age: float = parameter(
        0.5,
        'Frames older than this make the diagnostics warn: without them the force drifts.',
        unit='s',
        minimum=0.05,
        maximum=60.0,
    )
    longest_without_frame: float = parameter(
        2.0,
        'Frames older than this end the output: no force is published until the next frame.',
        unit='s',
        minimum=0.05,
        maximum=3600.0,
    )
    deadline: float = parameter(
        0.003,
        'Forces published later than this after the first events of the packet that completes their'
        ' window arrived at the host count as late on /diagnostics; a packet spans 1 ms.',
        unit='s',
        minimum=0.0005,
        maximum=1.0,
    )
