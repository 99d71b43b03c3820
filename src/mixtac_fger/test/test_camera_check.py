# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which cameras a model accepts."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mixtac_fger.config import ModelError
from mixtac_fger.estimator import SERIAL_KEY, CameraFacts, check_camera
from mixtac_fger.weights import LoadedModel, ModelCard

DAVIS = CameraFacts(346, 260, serial='V0000001')


def test_the_camera_of_the_model_is_accepted_and_the_unknown_is_not_judged(model):
    for camera in (DAVIS, CameraFacts(), CameraFacts(serial='anything')):
        check_camera(model, camera)


@pytest.mark.parametrize(
    ('change', 'text'),
    [
        ({'width': 640, 'height': 480}, '640 x 480'),
        ({'width': 260, 'height': 346}, '260 x 346'),
        ({'cut': True}, 'full resolution'),
    ],
)
def test_another_camera_is_refused(model, change, text):
    with pytest.raises(ModelError, match=text):
        check_camera(model, replace(DAVIS, **change))


def test_a_model_that_was_adapted_to_one_sensor_serves_no_other(model):
    adapted = LoadedModel(model.network, ModelCard(training={SERIAL_KEY: 'V0000001'}))
    check_camera(adapted, DAVIS)
    with pytest.raises(ModelError, match='V0000001, the camera is V0000002'):
        check_camera(adapted, replace(DAVIS, serial='V0000002'))
