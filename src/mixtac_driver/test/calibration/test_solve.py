# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Calibration against lenses of known truth, and refusal of views that cannot give one."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from board_camera import (
    COLUMNS,
    HEIGHT,
    ROWS,
    SQUARE_M,
    WIDE,
    WIDTH,
    BoardCamera,
    good_poses,
    perfect_views,
    rays,
)

from mixtac_driver.calibration.board import Board, find_board
from mixtac_driver.calibration.lens import (
    MODELS,
    CalibrationError,
    Refusal,
    RefusedError,
    undistort,
)
from mixtac_driver.calibration.solve import Demands, calibrate, fit_lens

MIDDLE = np.array([(WIDTH - 1) / 2, (HEIGHT - 1) / 2])


def angles_deg(model, lens):
    """Angle between the true and the found direction of pixels, by pixel [deg]."""
    x, y = (each.ravel() for each in np.meshgrid(np.arange(20, 326, 15), np.arange(20, 240, 15)))
    truth = rays(model, x, y)
    k = lens.calibration.camera_matrix
    points = np.stack([(x - k[0, 2]) / k[0, 0], (y - k[1, 2]) / k[1, 1]], 1)
    found = np.column_stack(
        [undistort(model, lens.calibration.distortion, points), np.ones(len(x))]
    )
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    truth /= np.linalg.norm(truth, axis=1, keepdims=True)
    return np.rad2deg(np.arccos(np.clip((found * truth).sum(axis=1), -1, 1)))


@pytest.mark.parametrize('model', MODELS)
def test_rendered_frames_give_the_lens_back(model):
    camera, rng = BoardCamera(model), np.random.default_rng(7)
    board = Board(COLUMNS, ROWS, SQUARE_M)
    views = [find_board(camera.image(*each, rng), board) for each in good_poses(model, 14, 11, 10)]
    solution = calibrate([each for each in views if each is not None], model=model)
    fx, fy, cx, cy, _ = WIDE[model]
    found = solution.parameters()
    assert found['fx'][0] == pytest.approx(fx, rel=0.01)
    assert found['fy'][0] == pytest.approx(fy, rel=0.01)
    assert found['cx'][0] == pytest.approx(cx, abs=0.5)
    assert found['cy'][0] == pytest.approx(cy, abs=0.5)
    assert solution.rms_px < 0.3
    wrong = angles_deg(model, solution)
    assert np.isfinite(wrong).mean() > 0.95
    assert np.nanmax(wrong) < 0.4


@pytest.mark.parametrize('model', MODELS)
def test_deviations_say_how_far_off_the_fit_is(model):
    fx, fy, cx, cy, _ = WIDE[model]
    scores = []
    for seed in range(8):
        views = perfect_views(model, 20, seed)
        found = calibrate(views, model=model).parameters()
        truth = {'fx': fx, 'fy': fy, 'cx': cx, 'cy': cy}
        scores += [(found[name][0] - truth[name]) / found[name][1] for name in truth]
    # Standard scores of 32 estimates; their mean square is 1 with a spread of some 0.3.
    assert 0.3 < np.mean(np.square(scores)) < 2.5


def test_deviations_are_opencvs():
    views = perfect_views('plumb_bob', 20, 3)
    _, matrix, _, _, _, deviations, _, _ = cv2.calibrateCameraExtended(
        [view.board.points().astype(np.float32) for view in views],
        [view.corners.astype(np.float32) for view in views],
        (WIDTH, HEIGHT),
        None,
        None,
    )
    fit = fit_lens(views, 'plumb_bob')
    np.testing.assert_allclose(fit.camera_matrix, matrix, atol=0.02)
    # OpenCV 4 counts each corner as one measurement, OpenCV 5 as two.
    measurements = (1 if cv2.__version__.startswith('4') else 2) * 20 * 54
    unknowns = 9 + 6 * 20
    expected = deviations.ravel()[:9] * np.sqrt((measurements - unknowns) / (2160 - unknowns))
    np.testing.assert_allclose(fit.deviations, expected, rtol=0.02)


@pytest.mark.parametrize('seed', range(4))
def test_the_rational_model_holds_where_opencv_alone_runs_away(seed):
    # From nothing, OpenCV 5 ends at 0.66 px with the second of these.
    solution = calibrate(perfect_views('equidistant', 20, seed), model='rational_polynomial')
    assert solution.rms_px < 0.1
    assert solution.folded < 0.05


def test_bad_views_are_thrown_out():
    views = perfect_views('equidistant', 24, 2)
    rng = np.random.default_rng(0)
    for index in (4, 17):
        views[index] = replace(
            views[index], corners=views[index].corners + rng.normal(0, 2.0, (54, 2))
        )
    solution = calibrate(views)
    assert {view.label for view, _ in solution.removed} == {'4', '17'}
    assert all(error > 1.0 for _, error in solution.removed)
    assert solution.rms_px < 0.1
    assert solution.parameters()['fx'][0] == pytest.approx(155.0, rel=0.005)


def test_errors_are_those_of_the_views():
    solution = calibrate(perfect_views('equidistant', 20, 2, noise=0.1))
    # Two coordinates; the fit takes up a little.
    assert solution.rms_px == pytest.approx(0.1 * np.sqrt(2), rel=0.1)
    assert solution.max_px == max(np.hypot(*each.T).max() for each in solution.fit.residuals)
    assert len(solution.fit.view_rms_px) == len(solution.views)


def reason(views, **options):
    with pytest.raises(RefusedError) as caught:
        calibrate(views, **options)
    assert str(caught.value).startswith(caught.value.reason.value)
    return caught.value.reason


def test_too_few_views_are_refused():
    assert reason([]) is Refusal.TOO_FEW_VIEWS
    assert reason(perfect_views('equidistant', 7, 1)) is Refusal.TOO_FEW_VIEWS


def test_the_same_view_again_and_again_is_refused():
    assert reason(perfect_views('equidistant', 3, 1) * 10) is Refusal.TOO_ALIKE


def test_views_of_the_middle_only_are_refused():
    rng = np.random.default_rng(0)
    held = [(rng.uniform(-0.7, 0.7, 3), rng.uniform(-1, 1, 3) * 0.002) for _ in range(20)]
    held = [
        (turn, place + np.array([0, 0, z]))
        for (turn, place), z in zip(held, [0.05, 0.09] * 10, strict=True)
    ]
    views = perfect_views('equidistant', 20, 1, held=held)
    assert reason(views) is Refusal.POOR_COVERAGE


def test_views_without_tilt_leave_the_focal_length_open():
    # A pinhole camera sees boards of any distance alike when they are held square to it.
    focal, board = 400.0, Board(COLUMNS, ROWS, SQUARE_M)
    rng, grid = np.random.default_rng(0), perfect_views('plumb_bob', 1, 1)[0]
    views = []
    for x in (-60, 0, 60):
        for y in (-40, 0, 40):
            for z in (0.08, 0.11):
                pixels = (board.points()[:, :2] - 0.014) * focal / z + MIDDLE + (x, y)
                noisy = pixels + rng.normal(0, 0.1, (54, 2))
                views.append(replace(grid, corners=noisy))
    demands = Demands(distinct_views=1, coverage=0.0, centre=9.0, aspect=9.0, folded=1.0)
    assert reason(views, model='plumb_bob', demands=demands) is Refusal.TOO_ALIKE


def test_a_wrong_board_is_refused():
    views = perfect_views('equidistant', 20, 1)
    rng = np.random.default_rng(0)
    shaken = [replace(v, corners=v.corners + rng.normal(0, 2.5, (54, 2))) for v in views]
    assert reason(shaken) in (Refusal.LARGE_RESIDUAL, Refusal.TOO_ALIKE, Refusal.NO_FIT)


def test_views_that_contradict_each_other_are_refused():
    views = perfect_views('equidistant', 12, 1) + [
        replace(v, corners=v.corners * 0.8 + 3.0 * np.sin(v.corners[:, ::-1] / 9))
        for v in perfect_views('equidistant', 10, 2)
    ]
    assert reason(views) in (Refusal.LARGE_RESIDUAL, Refusal.NO_FIT)


def test_a_stretched_image_is_refused():
    views = [
        replace(v, corners=v.corners * (1.0, 0.7)) for v in perfect_views('equidistant', 20, 1)
    ]
    assert reason(views) is Refusal.IMPLAUSIBLE


def test_a_polynomial_that_folds_back_is_refused():
    views = perfect_views('equidistant', 24, 1)
    demands = Demands(rms_px=9.0, folded=0.02)
    assert reason(views, model='plumb_bob', demands=demands) is Refusal.IMPLAUSIBLE


def test_what_cannot_be_asked_is_said():
    views = perfect_views('equidistant', 10, 1)
    with pytest.raises(CalibrationError):
        calibrate(views, model='ftheta')
    with pytest.raises(CalibrationError):
        calibrate(views, alpha=1.5)
    with pytest.raises(CalibrationError):
        calibrate([*views, replace(views[0], width=320)])
