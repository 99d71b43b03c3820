# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A clock map as a JSON file beside its bag."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from mixtac_alignment.fit_message import from_fields, to_fields
from mixtac_bringup.errors import BagError

if TYPE_CHECKING:
    from pathlib import Path

    from mixtac_alignment.clock_fit import ClockFit

SCHEMA = 1


def fit_path(bag: Path) -> Path:
    """Return where the fit of a bag lies."""
    return bag.with_name(f'{bag.name}.clock_fit.json')


def write_fit(fit: ClockFit, bag: Path) -> Path:
    """Write a fit beside its bag and return the file: the fields of `mixtac_msgs/ClockFit`."""
    path = fit_path(bag)
    content = {'schema': SCHEMA, 'bag': bag.name, **to_fields(fit)}
    path.write_text(json.dumps(content, indent=2) + '\n', encoding='utf-8')
    return path


def read_fit(bag: Path) -> ClockFit:
    """Return the fit beside a bag.

    Raises:
        BagError: No such file, or another schema.
        AlignmentError: The file describes no map.
    """
    path = fit_path(bag)
    try:
        content: dict[str, Any] = json.loads(path.read_text(encoding='utf-8'))
    except (OSError, ValueError) as error:
        raise BagError(f'no clock fit in {path} ({error}): run `mixtac align {bag}`') from error
    if content.get('schema') != SCHEMA:
        raise BagError(f'{path} has schema {content.get("schema")}, not {SCHEMA}: align again')
    return from_fields(content)
