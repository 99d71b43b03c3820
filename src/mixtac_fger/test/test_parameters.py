# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the estimator's node that contradict each other are refused."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mixtac_core.node.parameters import ParameterError
from mixtac_fger.parameters import FgerParameters


def test_a_contact_ends_below_the_force_at_which_it_begins():
    both = FgerParameters(contact_on=0.1, contact_off=0.1)
    assert replace(both, contact_off=0.05).contact_on == 0.1
    with pytest.raises(ParameterError) as caught:
        replace(both, contact_on=0.05)
    assert 'contact_off' in caught.value.message
