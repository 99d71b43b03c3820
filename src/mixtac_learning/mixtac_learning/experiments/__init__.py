# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The paper's experiments and the table of models.

To add an experiment, write a module with a function that `harness.experiment` decorates, and name
the function here.
"""

EXPERIMENTS = {
    'all': 'mixtac_learning.experiments.harness:all_experiments',
    'vibration': 'mixtac_learning.experiments.vibration:vibration',
    'stability': 'mixtac_learning.experiments.forces:stability',
    'inputs': 'mixtac_learning.experiments.forces:inputs',
    'fusion': 'mixtac_learning.experiments.forces:fusion',
    'impact': 'mixtac_learning.experiments.forces:impact',
    'slip': 'mixtac_learning.experiments.slip:slip',
    'model': 'mixtac_learning.experiments.model:model',
    'comparison': 'mixtac_learning.experiments.forces:comparison',
    'models': 'mixtac_learning.experiments.models:models',
}
"""Function of each command of `mixtac experiments`, in the order of the paper."""
