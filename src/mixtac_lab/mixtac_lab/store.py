# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Results of long computations on disk, keyed by inputs and by the version of the code.

A run that was interrupted continues where it stopped: a piece of work is computed only if no
result is stored for it. Results are JSON; larger arrays lie in files beside them whose names
begin with the same stem.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import multiprocessing
import os
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


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


_LOOK_S = 1.0
_WORD = '.word'


class Piece(Protocol):
    """One piece of work; must survive being sent to another process."""

    @property
    def label(self) -> str:
        """Begin of the names of its files."""

    def identity(self) -> str:
        """Return a text of all that changes the result."""

    def compute(self, folder: Path, stem: str) -> dict[str, Any]:
        """Return the result, JSON-ready.

        Args:
            folder: Where larger results go, in files whose names begin with `stem`.
            stem: As said.
        """


def stem_of(piece: Piece) -> str:
    """Return the begin of the names of a piece's files: label and digest of its identity."""
    digest = hashlib.blake2b(piece.identity().encode(), digest_size=6).hexdigest()
    return f'{piece.label}-{digest}'


def carry_out(
    pieces: Sequence[Piece],
    folder: Path,
    jobs: int = 1,
    advance: Callable[[], object] = lambda: None,
    say: Callable[[str], object] = lambda _text: None,
) -> list[dict[str, Any]]:
    """Return the results of pieces in their order; only those that are missing are computed.

    Args:
        pieces: What to do.
        folder: Where results are kept.
        jobs: Processes.
        advance: Called after each piece.
        say: Called now and then with how far the pieces under way are, where there are several
            processes.

    Raises:
        MixtacError: A piece cannot be carried out; those that were finished are kept.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for word in folder.glob(f'*{_WORD}'):  # of a run that was cut off
        word.unlink(missing_ok=True)
    results: dict[int, dict[str, Any]] = {}
    for index, piece in enumerate(pieces):
        found = _kept(folder / f'{stem_of(piece)}.json')
        if found is not None:
            results[index] = found
            advance()
    missing = [index for index in range(len(pieces)) if index not in results]
    if jobs == 1 or len(missing) == 1:
        for index in missing:
            results[index] = _carry_out_one(pieces[index], folder)
            advance()
    elif missing:
        _spread_out(pieces, missing, folder, jobs, results, advance, say)
    return [results[index] for index in range(len(pieces))]


def _spread_out(
    pieces: Sequence[Piece],
    missing: Sequence[int],
    folder: Path,
    jobs: int,
    results: dict[int, dict[str, Any]],
    advance: Callable[[], object],
    say: Callable[[str], object],
) -> None:
    context = multiprocessing.get_context('spawn')
    with ProcessPoolExecutor(
        min(jobs, len(missing)), mp_context=context, initializer=_one_thread
    ) as pool:
        futures = {pool.submit(_carry_out_one, pieces[i], folder): i for i in missing}
        open_ones = set(futures)
        try:
            while open_ones:
                finished, open_ones = wait(open_ones, _LOOK_S, FIRST_COMPLETED)
                for future in finished:
                    results[futures[future]] = future.result()
                    advance()
                say(', '.join(_told(folder)))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def tell(folder: Path, stem: str, text: str) -> None:
    """Leave word of how far a piece is, for the process that waits for it."""
    (folder / f'{stem}{_WORD}').write_text(text, encoding='utf-8')


def _told(folder: Path) -> list[str]:
    """Return what the pieces under way have said."""
    words = []
    for path in sorted(folder.glob(f'*{_WORD}')):
        with contextlib.suppress(OSError):  # it may have been finished meanwhile
            words.append(path.read_text(encoding='utf-8'))
    return words


def _one_thread() -> None:
    # Processes share the cores; libraries read this when they are loaded.
    for name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'):
        os.environ[name] = '1'


def _carry_out_one(piece: Piece, folder: Path) -> dict[str, Any]:
    stem = stem_of(piece)
    result = piece.compute(folder, stem)
    partial = folder / f'{stem}.partial'
    partial.write_text(json.dumps(result) + '\n', encoding='utf-8')
    partial.replace(folder / f'{stem}.json')
    (folder / f'{stem}{_WORD}').unlink(missing_ok=True)
    return result


def _kept(path: Path) -> dict[str, Any] | None:
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding='utf-8'))
    except (OSError, ValueError):
        return None
    return found


class Kept:
    """Results by their keys, one JSON line each.

    A key names what was measured and with which settings, not the version of the code: begin a new
    file after a change of the code.

    Args:
        path: The file; None keeps nothing.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self._known: dict[str, Any] = {}
        if path is not None and path.exists():
            for line in path.read_text(encoding='utf-8').splitlines():
                entry = json.loads(line)
                self._known[entry['key']] = entry['value']

    def get(self, key: str, measure: Callable[[], Any]) -> Any:  # noqa: ANN401
        """Return the kept result of a key, or measure and keep it.

        Args:
            key: Names the measurement.
            measure: Returns what JSON can hold; not a number is kept as such.
        """
        if key not in self._known:
            self._known[key] = measure()
            if self._path is not None:
                line = json.dumps({'key': key, 'value': self._known[key]})
                with self._path.open('a', encoding='utf-8') as file:
                    file.write(line + '\n')
        return self._known[key]


def digest(*parts: object) -> str:
    """Return a short name of settings: equal settings have equal names."""
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:12]
