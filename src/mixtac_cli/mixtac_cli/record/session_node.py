# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac record`: listen, check, write a bag, and report what was lost."""

from __future__ import annotations

import contextlib
import json as json_format
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import rclpy
import typer
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from rich.console import Console
from rich.live import Live

from mixtac_cli.record.checks import (
    ERROR,
    Finding,
    check_clocks,
    check_disk,
    check_topics,
    findings_table,
    free_bytes,
    progress_table,
)
from mixtac_cli.record.listener_node import Listener
from mixtac_cli.record.summary import FILE_NAME, add_recording, read_recordings
from mixtac_node.topics import REFERENCE
from mixtac_recordings.recording import RecordingError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.table import Table

    from mixtac_cli.record.summary import RecordingSummary


@dataclass(frozen=True)
class RecordOptions:
    """One recording.

    Attributes:
        output: Folder of the new bag.
        namespace: Namespace of the sensor.
        seconds: Planned length [s]; 0 until stopped.
        reference_topic: Topic of the reference force sensor.
        profile: What is done meanwhile, for `dataset.yaml`.
        split: `train`, `test` or empty, for `dataset.yaml`.
        check_seconds: For how long the checks listen [s].
        check_only: End after the checks.
        force: Record also where they found an error.
    """

    output: Path
    namespace: str = 'mixtac'
    seconds: float = 0.0
    reference_topic: str = REFERENCE
    profile: str = ''
    split: str = ''
    check_seconds: float = 2.0
    check_only: bool = False
    force: bool = False


DISCOVERY_S = 1.5
"""Best-effort messages in the first half second after a match are often lost."""
REFRESH_S = 0.5


class _Signals:
    """Notes the signals that end a recording, so that its bag is always closed.

    Attributes:
        stopping: Whether one came.
    """

    def __init__(self) -> None:
        self.stopping = False

    def note(self, _number: int, _frame: object) -> None:
        """Take a signal."""
        self.stopping = True


@contextlib.contextmanager
def _noted_signals() -> Iterator[_Signals]:
    signals = _Signals()
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.signal(number, signals.note) for number in numbers]
    try:
        yield signals
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


class Session:
    """One recording.

    Args:
        console: Where to show it.
        options: What was asked for.
    """

    def __init__(self, console: Console, options: RecordOptions) -> None:
        self._console, self._options = console, options

    def run(self) -> RecordingSummary | None:
        """Check, and record unless only a check was asked for.

        Raises:
            RecordingError: The checks found an error, or the bag cannot be written.
        """
        options = self._options
        if options.output.exists():
            raise RecordingError(f'{options.output} is there already: choose a folder that is new')
        read_recordings(options.output.absolute().parent / FILE_NAME)
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        node = Listener('record', f'/{options.namespace.strip("/")}')
        try:
            with _noted_signals() as signals:
                node.listen(options.reference_topic)
                executor = EventsExecutor()
                executor.add_node(node)
                self._check(node, executor, signals)
                if options.check_only or signals.stopping:
                    return None
                return self._record(node, executor, signals)
        finally:
            node.destroy_node()
            rclpy.try_shutdown()

    def _check(self, node: Listener, executor: EventsExecutor, signals: _Signals) -> None:
        with self._console.status('listening'):
            self._spin(executor, DISCOVERY_S, signals)
            for meter in node.meters:
                meter.restart()
            began_s = time.monotonic()
            self._spin(executor, self._options.check_seconds, signals)
            seconds = time.monotonic() - began_s
        if signals.stopping:
            return
        findings = self._findings(node, seconds)
        self._console.print(findings_table(findings))
        errors = [each for each in findings if each.level == ERROR]
        if errors and not self._options.force:
            raise RecordingError(
                f'not recorded: {errors[0].name}: {errors[0].text}; --force records all the same'
            )

    def _findings(self, node: Listener, seconds: float) -> list[Finding]:
        per_s = sum(meter.octets for meter in node.meters) / seconds
        disk = check_disk(free_bytes(self._options.output), per_s, self._options.seconds)
        clocks = check_clocks(time.time_ns(), node.stamps_ns(), simulated_time=node.has_clock())
        return [disk, *clocks, *check_topics(node.meters, node.publishers(), seconds)]

    def _record(
        self, node: Listener, executor: EventsExecutor, signals: _Signals
    ) -> RecordingSummary:
        options = self._options
        node.start(options.output)
        began_s = time.monotonic()
        with Live(console=self._console, auto_refresh=False, transient=True) as live:
            while not signals.stopping:
                left_s = options.seconds - (time.monotonic() - began_s)
                if (options.seconds and left_s <= 0) or (node.writer and node.writer.failure):
                    break
                step_s = min(left_s, REFRESH_S) if options.seconds else REFRESH_S
                self._spin(executor, step_s, signals)
                live.update(self._progress(node, time.monotonic() - began_s), refresh=True)
        self._console.print(self._progress(node, time.monotonic() - began_s))
        summary = node.finish()
        assert summary is not None  # noqa: S101  (started above)
        path = add_recording(options.output, summary, profile=options.profile, split=options.split)
        self._console.print(f'{options.output}: {summary.seconds:.1f} s, {summary.verdict()}')
        self._console.print(f'described in {path}')
        return summary

    def _progress(self, node: Listener, elapsed_s: float) -> Table:
        writer, output = node.writer, self._options.output
        return progress_table(
            node.meters,
            f'{output}, {elapsed_s:.0f} s; Ctrl-C ends and closes it',
            dropped=writer.dropped if writer else 0,
            disk_bytes=free_bytes(output),
        )

    @staticmethod
    def _spin(executor: EventsExecutor, seconds: float, signals: _Signals) -> None:
        end_s = time.monotonic() + seconds
        while not signals.stopping and (left_s := end_s - time.monotonic()) > 0:
            executor.spin_once(timeout_sec=min(left_s, 0.1))


OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)


def record(
    out: Annotated[Path, typer.Argument(help='Folder of the new bag.')],
    seconds: Annotated[float, typer.Option(min=0, help='Length (s); 0 until Ctrl-C.')] = 0,
    namespace: Annotated[str, typer.Option(help='Namespace of the sensor.')] = 'mixtac',
    reference_topic: Annotated[str, typer.Option(help='Reference force sensor.')] = REFERENCE,
    profile: Annotated[str, typer.Option(help='What is done, for dataset.yaml.')] = '',
    split: Annotated[str, typer.Option(help='train or test, for dataset.yaml.')] = '',
    check: Annotated[bool, typer.Option('--check', help='Check only, record nothing.')] = False,
    check_seconds: Annotated[float, typer.Option(min=0.5, help='How long to listen (s).')] = 2,
    force: Annotated[bool, typer.Option('--force', help='Record in spite of errors.')] = False,
    json: Annotated[OptionalPath, typer.Option(help='Write the summary there as well.')] = None,
) -> None:
    """Check disk, topics and clocks, record the running sensor, and say what was lost."""
    if split not in {'', 'train', 'test'}:
        raise typer.BadParameter(f'{split!r}: choose train or test', param_hint='--split')
    options = RecordOptions(
        out,
        namespace,
        seconds,
        reference_topic,
        profile,
        split,
        check_seconds,
        check_only=check,
        force=force,
    )
    summary = Session(Console(), options).run()
    if json is not None and summary is not None:
        json.write_text(json_format.dumps(summary.as_dict(), indent=2) + '\n')
