# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Safetensors files: tensors and a header of texts, written whole or not at all."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from torch import Tensor

    from mixtac_events.errors import MixtacError


def write_tensors(path: Path, tensors: dict[str, Tensor], header: dict[str, str]) -> None:
    """Write a file; an existing one is replaced only once the new one is complete.

    Args:
        path: File; its folder is made if need be.
        tensors: By name.
        header: Texts by name.
    """
    from safetensors.torch import save_file

    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + '.partial')
    # Copies: safetensors refuses tensors that share memory.
    kept = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()}
    save_file(kept, partial, metadata=header)
    partial.replace(path)


def read_tensors(
    path: Path, error_type: type[MixtacError], remedy: str
) -> tuple[dict[str, str], dict[str, Tensor]]:
    """Return header and tensors of a file.

    Args:
        path: File.
        error_type: Raised where the file is missing or damaged.
        remedy: What to do then, the end of that error's text.
    """
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise error_type(f'{path} does not exist: {remedy}')
    try:
        with safe_open(path, framework='pt') as file:
            return file.metadata() or {}, {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise error_type(f'{path} is not a safetensors file ({error}): {remedy}') from error
