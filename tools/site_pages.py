# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Hook of MkDocs: pages that lie outside docs/ become pages of the site, with their links."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parent.parent
PAGES = {
    'README.md': 'index.md',
    'CONTRIBUTING.md': 'contributing.md',
    'CHANGELOG.md': 'changelog.md',
    'QUALITY_DECLARATION.md': 'quality.md',
    'benchmarks/README.md': 'benchmarks.md',
    'examples/README.md': 'examples.md',
    'models/README.md': 'models.md',
}
"""Name in the site of each page outside of docs/."""
PLACES = {name: place for place, name in PAGES.items()}
LINK = re.compile(r'(!?)\[([^\]]*)\]\(([^)#:\s]+)(#[^)\s]+)?\)')


def on_files(files: Files, config: Any) -> Files:  # noqa: ANN401
    """Add the pages outside of docs/."""
    for place, name in PAGES.items():
        text = (ROOT / place).read_text(encoding='utf-8')
        if name == 'examples.md':
            text += ''.join(map(source, sorted((ROOT / 'examples').glob('*.py'))))
        files.append(File.generated(config, name, content=text))
    return files


def source(path: Path) -> str:
    """Return a section with the source of an example."""
    code = path.read_text(encoding='utf-8').split('\n', 2)[2]  # without the licence
    return f'\n## {path.name}\n\n```python\n{code}```\n'


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:  # noqa: ANN401
    """Return a page with links as of the site; of links to other files the text stays."""
    name = page.file.src_uri
    folder = (ROOT / PLACES.get(name, f'docs/{name}')).parent

    def link(match: re.Match[str]) -> str:
        mark, text, target, anchor = match.groups()
        path = Path(os.path.normpath(folder / target)).relative_to(ROOT).as_posix()
        if path in PAGES:
            return f'{mark}[{text}]({PAGES[path]}{anchor or ""})'
        if path.startswith('docs/') and (ROOT / path).is_file():
            return f'{mark}[{text}]({path.removeprefix("docs/")}{anchor or ""})'
        return text

    return LINK.sub(link, markdown)
