# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Digests of source files: results of other code are stale."""

from __future__ import annotations

import functools
import hashlib
from importlib.util import find_spec
from pathlib import Path

_BESIDE = ('usb', 'arm', 'grasp', 'datasets')


@functools.cache
def digest_of(*packages: str) -> str:
    """Return a digest of the Python files of packages, without their subpackages' tests."""
    digest = hashlib.blake2b(digest_size=6)
    for package in packages:
        for path in sorted(_folder(package).rglob('*.py')):
            digest.update(path.read_bytes())
    return digest.hexdigest()


@functools.cache
def sensor_digest() -> str:
    """Return a digest of the simulated sensor: the simulator without camera port, arm and grasp."""
    digest = hashlib.blake2b(digest_size=6)
    root = _folder('mixtac_sim')
    for path in sorted(root.rglob('*.py')):
        inside = path.relative_to(root).parts
        if inside[0] not in _BESIDE and not path.stem.endswith(('_node', '_parameters', '_cli')):
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _folder(package: str) -> Path:
    spec = find_spec(package)
    assert spec is not None  # noqa: S101  (packages of this project)
    assert spec.origin is not None  # noqa: S101
    return Path(spec.origin).parent
