# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The check of links finds those that lead nowhere."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

TOOL = runpy.run_path(str(Path(__file__).resolve().parents[1] / 'tools' / 'check_links.py'))


@pytest.mark.parametrize(
    ('link', 'is_wrong'),
    [
        ('[here](other.md)', False),
        ('[here](other.md#a-heading)', False),
        ('[here](#title)', False),
        ('[elsewhere](https://example.org/x#y)', False),
        ('```\n[code](missing.md)\n```', False),
        ('[here](missing.md)', True),
        ('[here](other.md#no-heading)', True),
        ('[here](#no-heading)', True),
    ],
)
def test_a_link_that_leads_nowhere_is_found(tmp_path, link, is_wrong):
    (tmp_path / 'other.md').write_text('# Other\n\n## A `heading`\n')
    page = tmp_path / 'page.md'
    page.write_text(f'# Title\n\n{link}\n')
    assert bool(TOOL['faults'](page)) == is_wrong
