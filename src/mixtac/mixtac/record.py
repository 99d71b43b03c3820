# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac record`: wait for the sensor, write a bag, and report the losses."""

from __future__ import annotations

import contextlib
import math
import shutil
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from diagnostic_msgs.msg import DiagnosticArray
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rosbags.interfaces import Connection

from mixtac.figures import make_table
from mixtac.monitor_node import CommandNode
from mixtac.options import Namespace, Profile, ReferenceTopic, Split
from mixtac_core.events.packets import CodecError, SequenceCounter, read_packet
from mixtac_core.node import topics
from mixtac_core.node.topics import DEFAULT_NAMESPACE, EVENTS, REFERENCE, Topic
from mixtac_core.recordings.bag import check_new
from mixtac_core.recordings.bag_writer import BagWriter
from mixtac_core.recordings.dataset import FILE_NAME, add_recording, read_recordings
from mixtac_core.recordings.recording import RecordingError

DEPTH = 1000
"""Least queue depth of a subscription: messages of about one second."""
DISCOVERY_S = 1.5
"""Best-effort messages in the first half second after a match are often lost [s]."""
REFRESH_S = 0.5
"""Period of the display [s]."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class TopicMeter:
    """Counts the messages of one topic.

    Only event packets have numbers that show a loss. The other topics show their rate and their
    longest gap.

    Args:
        topic: The topic.

    Attributes:
        topic: As given.
        messages: Messages that arrived whole.
        size: Their serialised size [bytes].
        missing: Event packets lost by their numbers; damaged messages.
        longest_gap_ns: Longest time between two arrivals [ns].
    """

    def __init__(self, topic: Topic) -> None:
        self.topic = topic
        self.restart()

    def restart(self) -> None:
        """Count from zero."""
        self.messages = self.size = self.missing = self.longest_gap_ns = 0
        self._first_ns = self._last_ns = 0
        # Packets that got lost before the bag was open are not missing in it.
        self._sequence = SequenceCounter()

    def add(self, received_ns: int, data: bytes) -> bool:
        """Count a serialised message, arrived at a host time [ns]; return whether it is whole."""
        try:
            if self.topic.type_name == EVENTS.type_name:
                self.missing += self._sequence.update(read_packet(data).seq)
        except CodecError:
            self.missing += 1
            return False
        self.messages += 1
        self.size += len(data)
        self._first_ns = self._first_ns or received_ns
        self.longest_gap_ns = max(self.longest_gap_ns, received_ns - (self._last_ns or received_ns))
        self._last_ns = received_ns
        return True

    @property
    def rate_hz(self) -> float:
        """Messages per second between first and latest arrival."""
        span_ns = self._last_ns - self._first_ns
        return (self.messages - 1) * 1e9 / span_ns if span_ns > 0 else 0.0

    def figures(self) -> dict[str, float]:
        """Return the figures of the topic for dataset.yaml."""
        return {
            'messages': self.messages,
            'rate_hz': round(self.rate_hz, 3),
            'longest_gap_s': round(1e-9 * self.longest_gap_ns, 6),
            'octets': self.size,
            'missing': self.missing,
        }


class Listener(CommandNode):
    """Meters all topics; writes them to a bag between `start` and `finish`.

    All methods are for the thread of its executor.

    Args:
        name: Name of the node.
        namespace: Namespace of the sensor.

    Attributes:
        meters: One per topic.
        writer: The bag that is written, or None.
    """

    def __init__(self, name: str, namespace: str = DEFAULT_NAMESPACE) -> None:
        super().__init__(name, namespace=namespace)
        self.meters: list[TopicMeter] = []
        self.writer: BagWriter | None = None
        self._simulated, self._serial = False, ''
        self._connections: dict[str, Connection] = {}
        self._began_ns = 0

    def listen(self, reference_topic: str) -> None:
        """Subscribe to all topics, except for latched ones: their one message comes after `start`.

        Args:
            reference_topic: Topic of the reference force sensor.

        Raises:
            RecordingError: It is a topic of the sensor itself.
        """
        reference = replace(topics.REFERENCE_WRENCH, name=reference_topic)
        namespace = self.get_namespace()
        own = {each.resolved(namespace) for each in topics.TOPICS if each.name != REFERENCE}
        if reference.resolved(namespace) in own:
            raise RecordingError(
                f'{reference_topic} is a topic of the sensor, not of its reference',
                remedy='name the topic of the reference force sensor',
            )
        for each in topics.TOPICS:
            topic = reference if each.name == REFERENCE else each
            topic = replace(topic, depth=1 if topic.latched else max(DEPTH, topic.depth))
            meter = TopicMeter(topic)
            self.meters.append(meter)
            if not topic.latched:
                self.subscribe_topic(topic, partial(self._on_message, meter), raw=True)
        self.subscribe_topic(topics.DIAGNOSTICS, self._on_diagnostics)

    def start(self, output: Path) -> None:
        """Start writing to a new bag; figures count from now.

        Raises:
            RecordingError: The folder exists already or cannot be made.
        """
        self.writer = BagWriter(output)
        for meter in self.meters:
            meter.restart()
            name, kind = meter.topic.resolved(self.get_namespace()), meter.topic.type_name
            self._connections[meter.topic.name] = self.writer.add_topic(
                name, kind, latched=meter.topic.latched
            )
            if meter.topic.latched:
                self.subscribe_topic(meter.topic, partial(self._on_message, meter), raw=True)
        self._began_ns = time.time_ns()

    def finish(self) -> dict[str, Any]:
        """Write the queued messages and close the bag that was started.

        Returns:
            Length [s] and losses for dataset.yaml.

        Raises:
            RecordingError: The bag could not be finished.
        """
        writer, self.writer = self.writer, None
        assert writer is not None  # noqa: S101  (`start` makes it)
        seconds = (time.time_ns() - self._began_ns) / 1e9
        writer.close()
        figures = {meter.topic.name: meter.figures() for meter in self.meters if meter.messages}
        return {
            'seconds': round(seconds, 3),
            'simulated': self._simulated,
            'serial': self._serial,
            'stopped': writer.failure,
            'not_written': writer.dropped,
            'not_arrived': sum(int(each['missing']) for each in figures.values()),
            'topics': figures,
        }

    def destroy_node(self) -> None:
        """Destroy the node; a bag that was not finished, because of an error, is now."""
        try:
            if self.writer is not None:
                self.finish()
        finally:
            super().destroy_node()

    def _on_message(self, meter: TopicMeter, data: bytes) -> None:
        received_ns, name = time.time_ns(), meter.topic.name
        if not meter.add(received_ns, data):
            # Nobody could read it from the bag.
            self.get_logger().warning(f'damaged message on {name}', throttle_duration_sec=5.0)
        elif self.writer is not None:
            self.writer.write(self._connections[name], received_ns, data)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        own = self.get_namespace().strip('/')
        for status in message.status:
            namespace, _, name = status.name.rpartition('/')
            if namespace == own:
                self._simulated |= any(
                    v.key == 'simulated' and v.value == 'True' for v in status.values
                )
                self._serial = status.hardware_id if name == 'driver' else self._serial


def verdict(figures: Mapping[str, Any]) -> str:
    """Return one line about length and losses of a recording, from its figures."""
    lost = [f'{each["missing"]} of {n}' for n, each in figures['topics'].items() if each['missing']]
    parts = [f'messages lost: {", ".join(lost)}'] if lost else []
    if figures['not_written']:
        parts.append(f'{figures["not_written"]} messages not written: the disk failed or is slow')
    if figures['stopped']:
        parts.append(f'ended early ({figures["stopped"]}), complete until then')
    return f'{figures["seconds"]:.1f} s, {"; ".join(parts) or "no losses"}'


def record(
    out: Annotated[Path, typer.Argument(help='Folder of the new bag.')],
    seconds: Annotated[
        float, typer.Option(min=0, help='Length of the recording (s); 0 records until Ctrl-C.')
    ] = 0,
    namespace: Namespace = DEFAULT_NAMESPACE,
    reference: ReferenceTopic = REFERENCE,
    profile: Profile = '',
    split: Split = '',
    wait: Annotated[
        float, typer.Option(min=0, help='Longest time to wait for the first event packet (s).')
    ] = 5,
) -> None:
    """Record the running sensor, and report the losses. `mixtac doctor` checks the sensor."""
    check_new(out)
    read_recordings(out.absolute().parent / FILE_NAME)
    console = Console(markup=False)
    with Listener.opened('record', namespace) as listener, _noted_signals() as stopping:
        listener.listen(reference)
        _wait_for_packet(console, listener, wait, stopping)
        if stopping():
            return
        listener.start(out)
        _show(console, listener, out, seconds or math.inf, stopping)
        figures = listener.finish()
        path = add_recording(out, figures, profile=profile, split=split)
    console.print(f'{out}: {verdict(figures)}')
    console.print(f'described in {path}')
    if figures['stopped']:
        raise RecordingError(
            f'{out} ends early: {figures["stopped"]}', remedy='free some space for the next one'
        )


@contextlib.contextmanager
def _noted_signals() -> Iterator[Callable[[], bool]]:
    """Note the signals that end a recording, so that its bag is closed; yield whether one came."""
    noted: list[int] = []
    before = [signal.signal(number, lambda got, _: noted.append(got)) for number in SIGNALS]
    try:
        yield lambda: bool(noted)
    finally:
        for number, handler in zip(SIGNALS, before, strict=True):
            signal.signal(number, handler)


def _wait_for_packet(
    console: Console, listener: Listener, seconds: float, stopping: Callable[[], bool]
) -> None:
    """Wait until event packets arrive.

    Raises:
        RecordingError: None came in time.
    """
    events = next(meter for meter in listener.meters if meter.topic.name == EVENTS.name)
    with console.status('waiting for event packets'):
        listener.spin_for(DISCOVERY_S, stopping)
        listener.spin_for(seconds, lambda: stopping() or events.messages > 0)
    if not events.messages and not stopping():
        raise RecordingError(
            f'no event packets on {events.topic.resolved(listener.get_namespace())}',
            remedy='start the sensor, or give its --namespace; `mixtac doctor` checks it',
        )


def _show(
    console: Console, listener: Listener, out: Path, seconds: float, stopping: Callable[[], bool]
) -> None:
    """Record until the time is over, a signal comes, or the disk fails; show the progress."""
    began_s = time.monotonic()
    with Live(console=console, auto_refresh=False) as live:
        while (elapsed_s := time.monotonic() - began_s) < seconds and not stopping():
            if listener.writer and listener.writer.failure:
                break
            listener.spin_for(min(seconds - elapsed_s, REFRESH_S), stopping)
            live.update(_progress(listener, out, elapsed_s), refresh=True)


def _progress(listener: Listener, out: Path, elapsed_s: float) -> Table:
    """Return the state of a recording; topics without messages are left out."""
    rows = [
        (
            m.topic.name,
            m.messages,
            f'{m.rate_hz:.1f}',
            f'{1e-9 * m.longest_gap_ns:.3f}',
            f'{m.size / 1e6:.2f}',
            m.missing,
        )
        for m in listener.meters
        if m.messages
    ]
    title = f'{out}, {elapsed_s:.0f} s; press Ctrl-C to stop'
    table = make_table(title, ('topic', 'messages', 'Hz', 'longest gap (s)', 'MB', 'lost'), rows)
    table.caption = f'{shutil.disk_usage(out).free / 1e9:.1f} GB left on the disk'
    return table
