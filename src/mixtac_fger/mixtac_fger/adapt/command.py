# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What `mixtac adapt` does."""

from __future__ import annotations

import json as json_module
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from rich.console import Console

from mixtac_fger.adapt.adaptation import adapt
from mixtac_fger.adapt.loads import parse_load
from mixtac_fger.adapt.material import gather_presses
from mixtac_fger.camera_check import SERIAL_KEY
from mixtac_fger.errors import CalibrationError
from mixtac_fger.train.model_card import write_model_card
from mixtac_fger.trials.bag_source import bag_sources
from mixtac_fger.weights import ModelCard, load_model, save_model

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from mixtac_fger.adapt.adaptation import Adapted
    from mixtac_fger.adapt.material import Material
    from mixtac_fger.trials.bag_source import BagSource


@dataclass(frozen=True, slots=True)
class AdaptRequest:
    """What to adapt by what.

    Attributes:
        bags: Recordings of one sensor, or folders of them.
        model: Weight file to start from.
        out: Weight file to write.
        loads: Known loads, texts like `0.5:3.0-6.0`; empty for the reference in the bags.
        reference: Topic of the reference force.
        json: File for the figures; None for none.
        serial: Serial number of the sensor's camera: the node refuses the file with another one.
            Empty where any camera will do.
    """

    bags: Sequence[Path]
    model: Path
    out: Path
    loads: Sequence[str] = ()
    reference: str = '/ft_sensor/wrench'
    json: Path | None = None
    serial: str = ''


def run_adaptation(request: AdaptRequest) -> None:
    """Adapt a model, write weight file and card, print what was chosen and why.

    Raises:
        CalibrationError: The presses do not allow it; the text says why.
        MixtacError: A bag or the model cannot be used.
    """
    torch.set_num_threads(1)
    console = Console()
    model = load_model(request.model)
    loads = [parse_load(text) for text in request.loads]
    sources = _sources(request)
    console.print(f'reading {len(sources)} recordings')
    trials = (each.load_camera() if loads else each.load() for each in sources)
    material = gather_presses(model.network, trials, loads)
    with console.status('adapting') as status:
        adapted = adapt(model.network, material.presses, status.update)
    figures = adaptation_figures(adapted, material)
    training = model.card.training | {
        'adapted': {'from': request.model.name, 'bags': [each.name for each in sources]} | figures
    }
    if request.serial:
        training[SERIAL_KEY] = request.serial
    card = ModelCard(training, {'adaptation': figures})
    save_model(request.out, adapted.network, card)
    write_model_card(request.out.with_suffix('.md'), request.out.name, card)
    _report(console, adapted, material)
    console.print(f'wrote {request.out}')
    if request.json is not None:
        content = {'model': str(request.model), 'out': str(request.out)} | figures
        request.json.write_text(json_module.dumps(content, indent=2) + '\n', encoding='utf-8')


def _sources(request: AdaptRequest) -> list[BagSource]:
    """Return the recordings to adapt by; test trials of a data set are not among them.

    Raises:
        CalibrationError: There are none, or of several sensors, or too many for known loads.
    """
    found = [each for bag in request.bags for each in bag_sources(bag, request.reference)]
    sources = [each for each in found if each.origin.get('split', 'train') != 'test']
    if not sources:
        raise CalibrationError(
            f'all of {len(found)} recordings are test trials of a data set: a model that was'
            ' adapted by them could not be judged; give others'
        )
    origins = [each.origin for each in sources]
    sensors = {str(origin.get('device_seed', origin.get('sensor', ''))) for origin in origins}
    if len(sensors) > 1:
        raise CalibrationError(
            f'the recordings are of {len(sensors)} sensors: give those of one, as each has a gel'
            ' of its own'
        )
    if request.loads and len(sources) != 1:
        raise CalibrationError(
            f'known loads belong to one recording, but there are {len(sources)}: give one bag'
        )
    return sources


def adaptation_figures(adapted: Adapted, material: Material) -> dict[str, Any]:
    """Return what was chosen and why, JSON-ready; forces in N, times in s."""
    held_out = {f'held_out_mae_{way}': round(v, 4) for way, v in adapted.held_out_mae.items()}
    return {
        'chosen': adapted.way,
        'gain': round(adapted.gain, 4),
        'presses': adapted.presses,
        'pressed_s': round(adapted.pressed_s, 1),
        'recorded_s': round(material.used_s, 1),
    } | held_out


def _report(console: Console, adapted: Adapted, material: Material) -> None:
    if material.left_out_s > 0.0:
        console.print(f'left out {material.left_out_s:.0f} s beyond the first minute')
    errors = ', '.join(f'{way} {mae:.3f} N' for way, mae in adapted.held_out_mae.items())
    console.print(f'{adapted.presses} presses; error on held-out presses: {errors}')
    console.print(f'chosen: {adapted.way}, gain {adapted.gain:.3f}')
