# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which bags `mixtac evaluate` judges."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

from mixtac_fger.weights import write_model
from mixtac_learning.judge import evaluation


def test_a_bag_that_is_named_is_judged_whatever_its_split(model, trial, tmp_path, monkeypatch):
    def sources(folder: Path, _reference: str) -> list[SimpleNamespace]:
        bags = [folder] if folder.suffix == '.bag' else [folder / 'a', folder / 'b']
        origins = [
            {'name': bag.name, 'split': 'test' if bag.name == 'b' else 'train'} for bag in bags
        ]
        return [
            SimpleNamespace(
                path=bag,
                name=bag.name,
                origin=origin,
                load=lambda origin=origin: replace(trial, origin=origin),
            )
            for bag, origin in zip(bags, origins, strict=True)
        ]

    monkeypatch.setattr(evaluation, 'bag_sources', sources)
    path, out = tmp_path / 'm.safetensors', tmp_path / 'figures.json'
    write_model(path, model)
    bags = [Path('one.bag'), Path('folder')]
    evaluation.run_evaluation(path, bags, reference='/w', json=out)
    assert json.loads(out.read_text())['bags'] == ['one.bag', 'b']
