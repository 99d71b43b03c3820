# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the cache of compiled code has to know about the sources.

Numba compiles a function anew when the file changes that it stands in, but not when a function or
a constant changes that it takes from another file. It does so when a variable that the function
closes over has changed: the fingerprint of those other files is such a variable.
"""

from __future__ import annotations

import zlib
from pathlib import Path


def source_fingerprint(*patterns: str, folder: Path = Path(__file__).parent) -> int:
    """Return a number that changes when one of these sources does.

    Args:
        patterns: Names of files in the folder, or patterns of names.
        folder: This package unless said otherwise.
    """
    fingerprint = 0
    for path in sorted(path for pattern in patterns for path in folder.glob(pattern)):
        fingerprint = zlib.crc32(path.read_bytes(), fingerprint)
    return fingerprint
