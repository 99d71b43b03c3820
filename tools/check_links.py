# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Check that links and pictures of the pages lead to files, and their anchors to headings."""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FENCE = re.compile(r'^( *)```.*?^\1```', re.DOTALL | re.MULTILINE)
LINK = re.compile(r'\]\(([^)#:\s]*)(?:#([^)\s]+))?\)')


def pages() -> list[Path]:
    """Return all pages that people read."""
    folders = ('.', 'docs', 'benchmarks', 'examples', 'models', 'integrations/*')
    return sorted(page for folder in folders for page in ROOT.glob(f'{folder}/*.md'))


def anchors(page: Path) -> set[str]:
    """Return the anchors of the headings of a page, as GitHub and MkDocs make them."""
    headings = re.findall(r'^#+ (.*)$', FENCE.sub('', page.read_text()), re.MULTILINE)
    return {re.sub(r'[^\w -]', '', each.lower()).replace(' ', '-') for each in headings}


def faults(page: Path) -> list[str]:
    """Return the links of a page that lead nowhere."""
    found = []
    for target, anchor in LINK.findall(FENCE.sub('', page.read_text())):
        path = page.parent / target if target else page
        if not path.exists():
            found.append(f'{page.name} links to {target}, which does not exist')
        elif anchor and anchor not in anchors(path):
            found.append(f'{page.name} links to #{anchor}, which is no heading of {path.name}')
    return found


def main() -> int:
    """Print one line per fault."""
    found = [fault for page in pages() for fault in faults(page)]
    print('\n'.join(found) or f'links of {len(pages())} pages in order')
    return 1 if found else 0


if __name__ == '__main__':
    sys.exit(main())
