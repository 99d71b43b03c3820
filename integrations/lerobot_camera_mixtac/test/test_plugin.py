# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""LeRobot finds the plugin by its name, and records an episode of the virtual sensor with it."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip('lerobot', reason='docs/python.md says how')
pytest.importorskip('lerobot_camera_mixtac', reason='the plugin is not installed')

from lerobot.cameras.configs import CameraConfig
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.utils.errors import DeviceNotConnectedError
from lerobot.utils.import_utils import register_third_party_plugins

FRAMES = 10


def test_lerobot_finds_the_camera_and_records_an_episode(tmp_path):
    datasets = pytest.importorskip('lerobot.datasets', reason='needs lerobot[dataset]')
    register_third_party_plugins()
    config = CameraConfig.get_choice_class('mixtac')(source='virtual:press')
    (camera,) = make_cameras_from_configs({'touch': config}).values()
    with pytest.raises(DeviceNotConnectedError):
        camera.read()
    shape = (config.height, config.width, 3)
    features = {
        'observation.images.touch': {
            'dtype': 'image',
            'shape': shape,
            'names': ['height', 'width', 'channels'],
        },
        'observation.force': {'dtype': 'float32', 'shape': (1,), 'names': ['normal']},
    }
    root = tmp_path / 'episode'
    dataset = datasets.LeRobotDataset.create(
        'mixtac/test', config.fps, features, root=root, use_videos=False
    )
    with camera:
        for _ in range(FRAMES):
            image = camera.read()
            force = camera.read_wrench()[0, 2:3]
            dataset.add_frame(
                {'observation.images.touch': image, 'observation.force': force, 'task': 'press'}
            )
        assert image.shape == shape
        assert image.dtype == np.uint8
    dataset.save_episode()
    dataset.finalize()
    found = datasets.LeRobotDataset('mixtac/test', root=root)
    assert len(found) == FRAMES
    assert found[0]['observation.images.touch'].shape == (3, *shape[:2])
