# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What all experiments share in one run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mixtac_bringup.experiments.pieces import carry_out

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from rich.progress import Progress

    from mixtac_bringup.experiments.pieces import Piece
    from mixtac_bringup.experiments.sizes import Sizes


@dataclass(frozen=True, slots=True)
class Context:
    """A run.

    Attributes:
        sizes: How large.
        folder: Where everything is kept.
        seeds: How many seeds: each is another training and, simulated, another sensor.
        jobs: Processes.
        bags: The user's recordings; None for simulated ones.
        progress: Where bars are shown.
    """

    sizes: Sizes
    folder: Path
    seeds: int
    jobs: int
    bags: Path | None
    progress: Progress

    @property
    def figures(self) -> Path:
        """Folder of the figures; made when it is asked for."""
        folder = self.folder / 'figures'
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    @property
    def pieces(self) -> Path:
        """Folder of finished pieces of work."""
        return self.folder / 'pieces'

    def run(self, title: str, pieces: Sequence[Piece]) -> list[dict[str, Any]]:
        """Return the results of pieces of work, with a bar meanwhile.

        Raises:
            MixtacError: One cannot be carried out.
        """
        bar = self.progress.add_task(title, total=len(pieces))

        def say(words: str) -> None:
            text = f'{title} ({words})' if words else title
            self.progress.update(bar, description=text)

        return carry_out(pieces, self.pieces, self.jobs, lambda: self.progress.advance(bar), say)
