# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""An .npz file whose arrays grow while it is made, in flat memory."""

from __future__ import annotations

import shutil
import tempfile
import zipfile
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.lib import format as npy

if TYPE_CHECKING:
    from numpy.typing import NDArray


class GrowingNpz:
    """Keeps each array in a file of its own until the end, then puts them into one .npz.

    Args:
        path: The new file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._folder = Path(tempfile.mkdtemp(prefix='.npz-', dir=path.parent))
        self._files: dict[str, IO[bytes]] = {}
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._types: dict[str, np.dtype[Any]] = {}

    def append(self, name: str, rows: NDArray[Any]) -> None:
        """Append rows to an array; all have the type and row shape of the first."""
        if name not in self._files:
            self._files[name] = (self._folder / name).open('w+b')
            self._shapes[name], self._types[name] = (0, *rows.shape[1:]), rows.dtype
        shape = self._shapes[name]
        if rows.shape[1:] != shape[1:]:
            raise ValueError(f'{name}: rows of {rows.shape[1:]} after rows of {shape[1:]}')
        self._files[name].write(np.ascontiguousarray(rows, self._types[name]).tobytes())
        self._shapes[name] = (shape[0] + len(rows), *shape[1:])

    def close(self) -> None:
        """Write the file."""
        with zipfile.ZipFile(self._path, 'x', zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for name, file in self._files.items():
                header = {
                    'descr': npy.dtype_to_descr(self._types[name]),
                    'fortran_order': False,
                    'shape': self._shapes[name],
                }
                file.seek(0)
                with archive.open(f'{name}.npy', 'w', force_zip64=True) as member:
                    npy.write_array_header_1_0(member, header)
                    shutil.copyfileobj(file, member, 1 << 20)
        self.discard()

    def discard(self) -> None:
        """Remove what was kept."""
        for file in self._files.values():
            file.close()
        shutil.rmtree(self._folder, ignore_errors=True)
