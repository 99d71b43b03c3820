# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which cameras a model accepts."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mixtac_fger.config import ModelError
from mixtac_fger.estimator import SERIAL_KEY, CameraFacts, check_camera
from mixtac_fger.fger_net import FgerEstimator
from mixtac_fger.weights import ModelCard

DAVIS = CameraFacts(346, 260, serial='V0000001')


def test_the_camera_of_the_model_is_accepted_and_the_unknown_is_not_judged(model):
    for camera in (DAVIS, CameraFacts(), CameraFacts(serial='anything')):
        check_camera(FgerEstimator(model), ModelCard(), camera)


@pytest.mark.parametrize(
    ('change', 'text'),
    [
        ({'width': 640, 'height': 480}, '640 x 480'),
        ({'width': 260, 'height': 346}, '260 x 346'),
        ({'cut': True}, 'full resolution'),
    ],
)
def test_another_camera_is_refused(model, change, text):
    with pytest.raises(ModelError) as caught:
        check_camera(FgerEstimator(model), ModelCard(), replace(DAVIS, **change))
    assert text in str(caught.value)


def test_a_model_that_was_adapted_to_one_sensor_serves_no_other(model):
    estimator, card = FgerEstimator(model), ModelCard(training={SERIAL_KEY: 'V0000001'})
    check_camera(estimator, card, DAVIS)
    with pytest.raises(ModelError) as caught:
        check_camera(estimator, card, replace(DAVIS, serial='V0000002'))
    assert 'V0000001' in str(caught.value)
    assert 'V0000002' in str(caught.value)
