# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Splitting data sets into training and test, 8:2, by whole trials or whole sensors."""

from __future__ import annotations

from typing import Final

from mixtac_sim.random_streams import stream

TRAIN_SHARE: Final = 0.8
"""Share of training in the paper's split (section 4.4)."""


def split_groups(count: int, seed: int) -> list[str]:
    """Return `train` or `test` for each of some groups, the same for the same arguments.

    Each side gets at least one group where there are two or more; a single one trains.

    Args:
        count: Groups: trials, or sensors with all of their trials.
        seed: Seed of the data set.
    """
    tests = round((1.0 - TRAIN_SHARE) * count)
    tests = max(tests, 1) if count > 1 else 0
    drawn = set(stream(seed, 'split').permutation(count)[:tests].tolist())
    return ['test' if group in drawn else 'train' for group in range(count)]
