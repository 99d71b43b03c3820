# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The file `dataset.yaml` beside recorded bags: one entry per recording."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import yaml

from mixtac_bringup.errors import BagError

if TYPE_CHECKING:
    from pathlib import Path

    from mixtac_bringup.record.summary import RecordingSummary

FILE_NAME: Final = 'dataset.yaml'
SCHEMA: Final = 'mixtac-recordings'
SCHEMA_VERSION: Final = 1


def add_recording(bag: Path, summary: RecordingSummary, *, profile: str, split: str) -> Path:
    """Add a recording to the file in its bag's parent folder, in one step, and return the file.

    Args:
        bag: Folder of the bag.
        summary: What became of it.
        profile: What was done, for example `static`; empty where that is not known.
        split: `train`, `test`, or empty.

    Raises:
        BagError: The file there is of something else, damaged, or cannot be written.
    """
    path = bag.absolute().parent / FILE_NAME
    document = read_recordings(path)
    others = [each for each in document['trials'] if each['name'] != bag.name]
    entry = {'name': bag.name, 'profile': profile, 'split': split, **summary.as_dict()}
    document['trials'] = [*others, entry]
    partial = path.with_name(f'.{FILE_NAME}.partial')
    try:
        partial.write_text(yaml.safe_dump(document, sort_keys=False), encoding='utf8')
        partial.replace(path)
    except OSError as error:
        raise BagError(f'{path} cannot be written ({error}); the bag itself is whole') from error
    return path


def read_recordings(path: Path) -> dict[str, Any]:
    """Read the file; where there is none, return one without recordings.

    Raises:
        BagError: It describes something else, or is damaged.
    """
    if not path.exists():
        return {'schema': SCHEMA, 'schema_version': SCHEMA_VERSION, 'trials': []}
    try:
        document = yaml.safe_load(path.read_text(encoding='utf8'))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise BagError(f'{path} cannot be read ({error}): move it away') from error
    known = isinstance(document, dict) and document.get('schema') == SCHEMA
    if not known or document.get('schema_version') != SCHEMA_VERSION:
        raise BagError(
            f'{path} does not describe recordings (schema {SCHEMA}, version {SCHEMA_VERSION}): '
            'record to another folder'
        )
    return dict(document)
