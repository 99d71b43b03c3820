# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""From parameters, masks and frames to what the camera is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixtac_driver.davis346.control import CameraControl
from mixtac_driver.errors import ConfigurationError, UsbError
from mixtac_driver.node.settings import DriverSettings
from mixtac_driver.parameters import DriverParameters
from mixtac_driver.pixels import PixelMask, save_mask
from mixtac_events.readings import Frame

AUTO = replace(DriverParameters(), aps_auto_exposure=True)


def frame(level):
    image = np.full((4, 4), level, np.uint16)
    return Frame(image, 0, 0, 0, 0, 0, 0, 0, global_shutter=True)


class Told(list):
    """What the camera was told, for apply and for exposures."""

    busy = False

    def set_exposure(self, exposure_us):
        if not self.busy:
            self.append(exposure_us)
        return not self.busy


def test_parameters_and_mask_are_applied_together(tmp_path):
    path = str(tmp_path / 'mask.png')
    save_mask(PixelMask([(3, 4)]), path)
    settings, told = DriverSettings(DriverParameters()), []
    settings.apply(replace(DriverParameters(), dvs_pixel_mask=path, roi_end_col=9), told.append)
    assert told[0].pixel_filter == ((3, 4),)
    assert told[0].roi.end_column == 9
    assert settings.mask.pixels == settings.file_mask.pixels == ((3, 4),)
    assert settings.configuration() == told[0]


@pytest.mark.parametrize('change', [{'dvs_pixel_mask': 'none.png'}, {'roi_start_row': 300}])
def test_what_cannot_be_leaves_everything_as_it_was(change):
    settings, told = DriverSettings(DriverParameters()), []
    with pytest.raises(ConfigurationError):
        settings.apply(replace(DriverParameters(), **change), told.append)
    assert told == []
    assert settings.parameters == DriverParameters()


def test_what_the_camera_refuses_is_not_kept():
    settings = DriverSettings(DriverParameters())

    def refuse(_configuration):
        raise UsbError('no')

    with pytest.raises(UsbError):
        settings.apply(AUTO, refuse)
    assert settings.parameters == DriverParameters()


def test_a_mask_in_use_survives_other_changes():
    settings, told = DriverSettings(DriverParameters()), []
    settings.use_mask(PixelMask([(k, 1) for k in range(10)]), told.append)
    settings.apply(replace(DriverParameters(), aps_exposure=100), told.append)
    assert told[1].pixel_filter == tuple((k, 1) for k in range(8))
    settings.use_mask(settings.mask, told.append, in_camera=False)
    assert told[2].pixel_filter == ()
    assert len(settings.mask.pixels) == 10


def test_exposure_is_left_alone_unless_it_is_wanted():
    settings, told = DriverSettings(DriverParameters()), Told()
    settings.follow(frame(5), 7000.0, told)
    assert told == []


def test_frames_set_the_exposure_and_other_changes_keep_it():
    settings, told = DriverSettings(AUTO), Told()
    settings.follow(frame(800), 7000.0, told)
    assert told[0] < 7000
    seen = []
    settings.apply(replace(AUTO, roi_end_col=9), seen.append)
    assert seen[0].aps_exposure_us == told[0]
    settings.apply(replace(AUTO, aps_exposure=500), seen.append)
    assert seen[1].aps_exposure_us == 500
    settings.apply(DriverParameters(), seen.append)
    assert seen[2].aps_exposure_us == 7000


def test_a_busy_camera_is_told_with_a_later_frame():
    settings, told = DriverSettings(AUTO), Told()
    told.busy = True
    settings.follow(frame(800), 7000.0, told)
    assert settings.configuration().aps_exposure_us == 7000
    told.busy = False
    settings.follow(frame(800), 7000.0, told)
    assert settings.configuration().aps_exposure_us == told[0] < 7000


def test_frames_that_do_not_say_their_exposure_are_left_out():
    settings, told = DriverSettings(AUTO), Told()
    settings.follow(frame(800), 0.0, told)
    assert told == []


def test_a_closed_camera_takes_the_exposure_too():
    settings = DriverSettings(AUTO)
    control = CameraControl(settings.configuration())
    settings.follow(frame(800), 7000.0, control)
    assert control.configuration.aps_exposure_us < 7000
