# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Write files completely or not at all; read files into checked dataclasses; find installed files.

Every error message names the path.
"""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import errno
import fcntl
import functools
import json
import os
import re
import secrets
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import yaml

from mixtac_core.events.errors import MixtacError

T = TypeVar('T')


class FileError(MixtacError):
    """A file that cannot be read or written, or whose content is invalid."""


class ShareError(MixtacError):
    """A package whose files are not installed."""


def share(package: str) -> Path:
    """Return the folder of the files that a package installs, with ROS or without.

    Args:
        package: Name of a package in an ament index, or of one that pip has installed.

    Raises:
        ShareError: The package is not installed.
    """
    installed = Path(sys.prefix) / 'share' / package
    try:
        from ament_index_python.packages import get_package_share_directory

        return Path(get_package_share_directory(package))
    except (ImportError, LookupError, OSError) as error:  # no ROS, or none that has this package
        if installed.is_dir():
            return installed
        raise ShareError(
            f'the files of {package} are not installed',
            remedy='run "make setup", or source the workspace that has it',
        ) from error


@contextlib.contextmanager
def _explained(failure: str, remedy: str = '') -> Iterator[None]:
    """Raise errors of the system as FileError.

    Args:
        failure: Which action on which path fails.
        remedy: What the user can do.
    """
    try:
        yield
    except OSError as error:
        raise FileError(f'{failure}: {error.strerror or error}', remedy=remedy) from error


_PLAIN = re.compile(r'[A-Za-z0-9][A-Za-z0-9._-]{0,199}')


def state_file(name: str) -> Path:
    """Return the file of a name in the user's state folder.

    The folder is `$MIXTAC_HOME`, or else `$XDG_STATE_HOME/mixtac` (`~/.local/state/mixtac`). Nodes
    take names of files to write from parameters, which anyone on the network may set: they write
    nowhere else.

    Args:
        name: At most 200 letters, digits, `.`, `_` and `-`; or the full path of such a file in
            this folder.

    Raises:
        FileError: The name contains other characters, is too long, or is outside this folder.
    """
    home = os.environ.get('MIXTAC_HOME')
    state = os.environ.get('XDG_STATE_HOME') or '~/.local/state'
    folder = Path(home or f'{state}/mixtac').expanduser()
    path = Path(name).expanduser()
    plain = path.name if path.parent in {Path(), folder} else name
    if not _PLAIN.fullmatch(plain):
        raise FileError(
            f'{name!r} is not the name of a file in {folder}',
            remedy='give a name of at most 200 letters, digits, ".", "_" and "-", such as'
            ' left_finger.npz, or set MIXTAC_HOME to another folder',
        )
    return folder / plain


def writable(path: Path | None) -> Path | None:
    """Return the path of a file to write, checked before the work whose result it is to hold.

    Raises:
        FileError: It is a folder, a device or a pipe, or lies in no folder that can be written or
            made.
    """
    if path is None:
        return None
    with _explained(f'cannot write {path}'):
        # A file that takes its place would replace a device for all programs.
        if not path.name or (path.exists() and not path.is_file()):
            raise FileError(f'cannot write {path}: it is no plain file', remedy='name a file')
        folder = next(each for each in path.absolute().parents if each.exists())
        if not (folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)):
            raise FileError(f'cannot write {path}', remedy='choose a writable folder')
    return path


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`, with its suffix, and move it into place on success.

    Makes the parent folder. When the block raises, the content of `path` is unchanged. If `path` is
    a link, the file that it leads to is replaced.

    Raises:
        FileError: The file cannot be written.
    """
    writable(path)
    target = Path(os.path.realpath(path))
    scratch = target.with_name(f'.{target.stem}.{secrets.token_hex(4)}{path.suffix}')
    with _explained(f'cannot write {path}', 'choose a writable place with free space'):
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            yield scratch
            scratch.replace(target)
        finally:
            scratch.unlink(missing_ok=True)


@contextlib.contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Yield the path of a folder to make, and move it to `path` on success.

    Makes the parent folder. When the block raises, nothing is left; a killed process leaves a
    folder `.unfinished-*` beside `path`.

    Raises:
        FileError: `path` exists, also when the block has ended, or cannot be written.
    """
    with _explained(f'cannot write {path}', 'choose a new folder with free space'):
        if path.exists() or path.name in ('', '..'):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix='.unfinished-', dir=path.parent) as scratch:
            made = Path(scratch) / path.name
            yield made
            made.rename(path)


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder, which ends with the process, however that ends.

    Waits for other processes, and goes on without a lock where the file system has none.

    Raises:
        OSError: The folder cannot be opened.
    """
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, whole or not at all.

    Raises:
        FileError: It cannot be written.
    """
    with replacing(path) as scratch:
        scratch.write_text(text, encoding='utf-8')


def write_json(path: Path | None, data: object) -> None:
    """Write a JSON file with an indent of 2, whole or not at all; nothing to None.

    Raises:
        FileError: It cannot be written.
    """
    if path is not None:
        write_text(path, json.dumps(data, indent=2) + '\n')


def read_data(path: Path) -> Any:  # noqa: ANN401
    """Return the content of a YAML file, or of a JSON file (by its suffix).

    Raises:
        FileError: It is missing, unreadable, or neither.
    """
    try:
        with _explained(f'cannot read {path}'):
            text = path.read_text(encoding='utf-8')
        return json.loads(text) if path.suffix == '.json' else yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        kind = 'JSON' if path.suffix == '.json' else 'YAML'
        raise FileError(f'{path} is not valid {kind}: {" ".join(str(error).split())}') from error


def read_dataclass(path: Path, cls: type[T]) -> T:
    """Return the content of a YAML or JSON file as a dataclass; see `structure`.

    Raises:
        FileError: The file cannot be read, or a value is not allowed.
    """
    return structure(read_data(path), cls, str(path))


def structure(data: object, cls: type[T], where: str) -> T:
    """Return a dataclass from mappings, lists and plain values, checked against its types.

    Unknown keys are refused with the nearest known one. Values are not converted, except for
    integers where floats are expected.

    Args:
        data: As YAML and JSON give it.
        cls: The dataclass. Its fields are plain values, dataclasses, `X | None`, `Any`, or
            `list`, `tuple` and `dict` of these.
        where: File or section, for the message.

    Raises:
        FileError: A key is unknown or missing, or a value has another type or is not allowed.
    """
    if not isinstance(data, dict):
        raise FileError(f'{where}: a mapping is expected, not {data!r}')
    kinds = _kinds(cls)  # type: ignore[arg-type]
    if unknown := [each for each in data if each not in kinds]:
        near = difflib.get_close_matches(str(unknown[0]), kinds, 1) or [', '.join(kinds)]
        raise FileError(f'{where}: unknown key {unknown[0]!r}; did you mean {near[0]}?')
    for each in dataclasses.fields(cls):  # type: ignore[arg-type]
        if each.default is each.default_factory is dataclasses.MISSING and each.name not in data:
            raise FileError(f'{where}: key {each.name!r} is missing')
    values = {name: _checked(each, kinds[name], f'{where}: {name}') for name, each in data.items()}
    try:
        return cls(**values)
    except (MixtacError, ValueError, TypeError) as error:
        raise FileError(f'{where}: {error}') from error


@functools.cache
def _kinds(cls: type[Any]) -> dict[str, Any]:
    hints = get_type_hints(cls)
    return {each.name: hints[each.name] for each in dataclasses.fields(cls)}


def _checked(value: Any, kind: Any, where: str) -> Any:  # noqa: ANN401
    """Return a value of a type that `structure` allows."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin is UnionType:
        return None if value is None else _checked(value, inner[0], where)
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        return structure(value, kind, where)
    if origin is dict and isinstance(value, dict):
        return {key: _checked(each, inner[1], f'{where}: {key}') for key, each in value.items()}
    if origin in (list, tuple) and isinstance(value, (list, tuple)):
        kinds = inner if inner[-1] is not Ellipsis and origin is tuple else inner[:1] * len(value)
        if len(kinds) == len(value):
            return origin(_checked(e, k, where) for e, k in zip(value, kinds, strict=True))
    if kind is float and type(value) is int:
        return float(value)
    if kind is not Any and type(value) is not kind:
        name = kind.__name__ if isinstance(kind, type) else kind
        raise FileError(f'{where}: {name} is expected, not {value!r}')
    return value
