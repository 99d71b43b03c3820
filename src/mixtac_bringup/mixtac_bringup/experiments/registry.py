# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The experiments by name; each is imported when it is carried out."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from mixtac_bringup.errors import ExperimentError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mixtac_bringup.experiments.context import Context
    from mixtac_bringup.experiments.rows import Outcome

NAMES = (
    'vibration',
    'stability',
    'inputs',
    'fusion',
    'impact',
    'slip',
    'model',
    'comparison',
)
"""In the order of the paper."""
ALL = 'all'


def chosen(names: Sequence[str]) -> tuple[str, ...]:
    """Return the experiments that some names mean, each once, in the order of the paper.

    Raises:
        ExperimentError: There is no such experiment.
    """
    unknown = sorted(set(names) - {*NAMES, ALL})
    if unknown:
        raise ExperimentError(
            f'experiment {unknown[0]!r} is unknown: choose of {", ".join(NAMES)}, or {ALL}'
        )
    return NAMES if ALL in names else tuple(name for name in NAMES if name in names)


def carry_out_experiment(name: str, context: Context) -> Outcome:
    """Carry an experiment out.

    Raises:
        MixtacError: It cannot be.
    """
    module = import_module(f'mixtac_bringup.experiments.{name}')
    outcome: Outcome = getattr(module, name)(context)
    return outcome
