# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Summary of a finished recording, and its entry in `dataset.yaml` beside the bag."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

import yaml

from mixtac_recordings.recording import RecordingError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from mixtac_cli.record.meter import TopicMeter


@dataclass(frozen=True, slots=True)
class TopicFigures:
    """One topic of a recording.

    Attributes:
        messages: Messages that arrived.
        rate_hz: Their rate.
        octets: Their size [bytes].
        missing: See `TopicMeter`.
        backwards: See `TopicMeter`.
    """

    messages: int
    rate_hz: float
    octets: int
    missing: int
    backwards: int


@dataclass(frozen=True, slots=True)
class RecordingSummary:
    """A recording that has ended.

    Attributes:
        seconds: Its length on the host clock [s].
        dropped: Messages that arrived and were not written, as the disk was too slow.
        simulated: Whether the data say that they are.
        serial: Hardware id of the driver.
        topics: Figures of the topics on which anything arrived, by name.
    """

    seconds: float
    dropped: int
    simulated: bool
    serial: str
    topics: dict[str, TopicFigures]

    @staticmethod
    def of(
        meters: Sequence[TopicMeter], seconds: float, dropped: int, *, simulated: bool, serial: str
    ) -> RecordingSummary:
        """Return the summary of what was metered."""
        topics = {
            m.topic.name: TopicFigures(m.messages, m.rate_hz, m.octets, m.missing, m.backwards)
            for m in meters
            if m.messages
        }
        return RecordingSummary(seconds, dropped, simulated, serial, topics)

    @property
    def missing(self) -> int:
        """Messages that did not arrive, of all topics."""
        return sum(each.missing for each in self.topics.values())

    def verdict(self) -> str:
        """Return one line that says what was lost."""
        lost = [f'{t.missing} of {name}' for name, t in self.topics.items() if t.missing]
        parts = [f'did not arrive: {", ".join(lost)}'] if lost else []
        if self.dropped:
            parts.append(f'{self.dropped} messages not written: the disk was too slow')
        back = [name for name, t in self.topics.items() if t.backwards]
        if back:
            parts.append(f'stamps or numbers went back on {", ".join(back)}')
        return '; '.join(parts) if parts else 'nothing was lost'

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for YAML and JSON."""
        return {
            'seconds': round(self.seconds, 3),
            'simulated': self.simulated,
            'serial': self.serial,
            'not_written': self.dropped,
            'not_arrived': self.missing,
            'topics': {
                name: {**asdict(each), 'rate_hz': round(each.rate_hz, 3)}
                for name, each in self.topics.items()
            },
        }


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
        RecordingError: The file there is of something else, damaged, or cannot be written.
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
        raise RecordingError(
            f'{path} cannot be written ({error}); the bag itself is whole'
        ) from error
    return path


def read_recordings(path: Path) -> dict[str, Any]:
    """Read the file; where there is none, return one without recordings.

    Raises:
        RecordingError: It describes something else, or is damaged.
    """
    if not path.exists():
        return {'schema': SCHEMA, 'schema_version': SCHEMA_VERSION, 'trials': []}
    try:
        document = yaml.safe_load(path.read_text(encoding='utf8'))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise RecordingError(f'{path} cannot be read ({error}): move it away') from error
    known = isinstance(document, dict) and document.get('schema') == SCHEMA
    if not known or document.get('schema_version') != SCHEMA_VERSION:
        raise RecordingError(
            f'{path} does not describe recordings (schema {SCHEMA}, version {SCHEMA_VERSION}): '
            'record to another folder'
        )
    return dict(document)
