# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Work in pieces: what is there is not done again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import pytest

from mixtac_lab.store import carry_out, stem_of, tell

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True)
class Squared:
    value: int
    log: Path
    version: int = 0

    @property
    def label(self):
        return f'squared_{self.value}'

    def identity(self):
        return f'{self.value} {self.version}'

    def compute(self, folder, stem):
        assert (folder / f'{stem}.json').parent.is_dir()
        with self.log.open('a') as file:
            file.write(f'{self.value}\n')
        if self.value < 0:
            raise ValueError(self.value)
        tell(folder, stem, f'squaring {self.value}')
        return {'square': self.value**2}


@pytest.mark.parametrize('jobs', [1, 2])
def test_results_come_in_order_and_only_missing_ones_are_computed(tmp_path, jobs):
    log, folder = tmp_path / 'log', tmp_path / 'pieces'
    pieces = [Squared(k, log) for k in range(4)]
    seen = []
    carry_out(pieces[1:3], folder)
    results = carry_out(pieces, folder, jobs, lambda: seen.append(1))
    assert [each['square'] for each in results] == [0, 1, 4, 9]
    assert len(seen) == 4
    assert not list(folder.glob('*.word'))
    assert sorted(log.read_text().split()) == ['0', '1', '2', '3']


def test_a_run_that_was_cut_off_goes_on(tmp_path):
    log, folder = tmp_path / 'log', tmp_path / 'pieces'
    with pytest.raises(ValueError, match='-1'):
        carry_out([Squared(2, log), Squared(-1, log), Squared(3, log)], folder)
    (folder / f'{stem_of(Squared(3, log))}.json').write_text('{"squ')  # a damaged result
    results = carry_out([Squared(2, log), Squared(3, log)], folder)
    assert [each['square'] for each in results] == [4, 9]
    assert log.read_text().split() == ['2', '-1', '3']


def test_another_identity_is_another_piece(tmp_path):
    log, folder = tmp_path / 'log', tmp_path / 'pieces'
    carry_out([Squared(2, log), Squared(2, log, version=1)], folder)
    assert log.read_text().split() == ['2', '2']
