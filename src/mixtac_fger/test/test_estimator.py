# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Estimators by their registry, the cameras that models accept, and parameters of the node."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from mixtac_core.events.arrays import Events
from mixtac_core.node.parameters import ParameterError
from mixtac_fger.config import ModelError
from mixtac_fger.estimator import SERIAL_KEY, CameraFacts, check_camera, open_estimator
from mixtac_fger.fger_net import FgerEstimator
from mixtac_fger.parameters import FgerParameters
from mixtac_fger.streaming import ForceEstimator, warm_up
from mixtac_fger.weights import Model, ModelCard, read_model, write_model

SOURCE = '''
from mixtac_fger.estimator import EncodedFrame, Estimator

class Counting(Estimator):
    """Returns `gain` newtons per event."""
    def __init__(self, model):
        self.width, self.height = model.config['width'], model.config['height']
        self.window_us = 2000
        self.gain = float(model.tensors['gain'][0])

    def encode(self, image, mid_us):
        return EncodedFrame(mid_us, 0.0, 0, None)

    def correct(self, frame, lag): ...
    def start_at(self, frame): ...
    def clear(self): ...

    def step(self, events, end_us):
        return self.gain * len(events), None
'''
DAVIS = CameraFacts(346, 260, serial='V0000001')


@pytest.fixture
def outside(tmp_path, monkeypatch) -> Model:
    """Install a package that registers `counting`, and return a model of it from a file."""
    (tmp_path / 'counting_estimator.py').write_text(SOURCE)
    info = tmp_path / 'counting_estimator-1.0.dist-info'
    info.mkdir()
    (info / 'METADATA').write_text(
        'Metadata-Version: 2.1\nName: counting_estimator\nVersion: 1.0\n'
    )
    (info / 'entry_points.txt').write_text(
        '[mixtac.estimators]\ncounting = counting_estimator:Counting\n'
        'broken = counting_estimator_missing:Broken\n'
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, 'counting_estimator', raising=False)
    tensors = {'gain': np.array([0.5], np.float32)}
    path = tmp_path / 'counting.safetensors'
    write_model(path, Model('counting', 1, {'width': 8, 'height': 6}, ModelCard(), tensors))
    return read_model(path)


def test_an_architecture_from_outside_runs_like_any_other(outside):
    assert warm_up(open_estimator(outside))
    estimator = ForceEstimator(open_estimator(outside), background_frames=True)
    estimator.push_frame(np.zeros((6, 8), np.uint8), 1000)
    estimator.drain()
    pixels = np.zeros(3, np.uint16)
    events = Events(np.array([2000, 2500, 3999]), pixels, pixels, np.ones(3, np.bool_))
    found = estimator.push_events(events, 4000)
    estimator.close()
    assert [(each.end_us, each.force) for each in found] == [(4000, 1.5)]
    with pytest.raises(ModelError) as caught:
        open_estimator(Model('broken', 1, {}, ModelCard(), {}))
    assert caught.value.remedy


CODE = """
import sys
sys.modules.update(dict.fromkeys(['torch', 'matplotlib', 'mixtac_learning', 'mixtac_sim']))
from mixtac_fger.estimator import open_estimator
from mixtac_fger.weights import find_model, read_model
import mixtac_fger.live_feed
print(open_estimator(read_model(find_model('fger_small'))).window_us)
"""


def test_the_shipped_model_opens_where_torch_cannot_be_imported():
    done = subprocess.run([sys.executable, '-c', CODE], check=True, capture_output=True, text=True)
    assert done.stdout.split() == ['2000']


@pytest.mark.parametrize(
    ('change', 'text'),
    [
        ({'width': 640, 'height': 480}, '640 x 480'),
        ({'width': 260, 'height': 346}, '260 x 346'),
        ({'serial': 'V0000002'}, 'V0000001'),
    ],
)
def test_cameras_that_do_not_fit_the_model_are_refused(model, change, text):
    estimator, card = FgerEstimator(model), ModelCard(training={SERIAL_KEY: DAVIS.serial})
    for camera in (DAVIS, CameraFacts()):
        check_camera(estimator, card, camera)
    check_camera(estimator, ModelCard(), replace(DAVIS, serial='V0000002'))
    with pytest.raises(ModelError) as caught:
        check_camera(estimator, card, replace(DAVIS, **change))
    assert text in str(caught.value)


def test_a_contact_ends_below_the_force_at_which_it_begins():
    both = FgerParameters(contact_on=0.1, contact_off=0.1)
    assert replace(both, contact_off=0.05).contact_on == 0.1
    with pytest.raises(ParameterError) as caught:
        replace(both, contact_on=0.05)
    assert 'contact_off' in caught.value.message
