# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fuzz test of the nodes: random and mutated messages to every subscription and service.

What a node subscribes to and serves is asked of the node, so that nothing can be forgotten. In
process (`--messages`) the callbacks are called directly; live (`--live`) the messages go over DDS
to the node in a process of its own. Mutated are one field or several of a sound message, or bytes
of its serialised form.
"""

from __future__ import annotations

import re
import tempfile
from array import array
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from random import Random
from typing import Annotated, Any, Optional, Protocol

import typer
from rich.console import Console

from mixtac_cli.figures import make_table
from mixtac_cli.options import JsonFile
from mixtac_lab.bench.harness import BenchRun
from mixtac_node.files import write_json
from mixtac_node.graph import NodeSpec, sensor_graph, slip_control
from mixtac_node.process import GraphError, ProcessGroup
from mixtac_node.topics import message_class

NAMESPACE = 'mixtac_fuzz'
LONGEST_S = 7200.0
"""Longest time that one node takes [s]."""
DIRECT = ('fger', 'slip_control', 'alignment', 'force_error', 'virtual_arm')
"""Nodes whose callbacks can be called in process: without threads and devices."""


def nodes(folder: Path) -> dict[str, NodeSpec]:
    """Return the nodes that are fuzzed, by name.

    Args:
        folder: For what they write.
    """
    sensor = sensor_graph(f'virtual:{folder}/usb.sock', align=True, estimator=ESTIMATOR)
    recorder = {'output': str(folder / 'bag')}
    others = [
        slip_control({'arm': 'fr3'}),
        NodeSpec('mixtac_cli', 'recorder_node', 'recorder', overrides=recorder),
        NodeSpec('mixtac_cli', 'supervisor_node', 'supervisor'),
        NodeSpec('mixtac_sim', 'virtual_arm_node', 'virtual_arm'),
        NodeSpec('mixtac_sim', 'virtual_grasp_node', 'virtual_grasp'),
    ]
    return {node.name: node for node in [*sensor, *others]}


ESTIMATOR = {'invalid_force': 'publish'}
REAL = (0.0, -0.0, 1.0, -1.0, 1e-310, 1e308, -1e308, float('nan'), float('inf'), float('-inf'))
WORDS = (
    *(
        '',
        'x',
        ' ',
        '/',
        '../../x',
        '/etc/passwd',
        'x' * 10_000,
        '\u00e9\u4e2d',
        '{}',
        '%s%n',
        '-1',
    ),
    *('mono8', 'mono16', 'rgb8', 'bgra16', '16UC1', '32FC1', 'bayer_rggb8', 'yuv422'),
    *('libcaer_cmp', 'libcaer', 'mono', 'evt3', 'camera', 'fger_small'),
)
ARRAY = re.compile(r'(?P<element>.+)\[(?P<count>\d+)\]')
SEQUENCE = re.compile(r'sequence<(?P<element>[^,>]+)(, (?P<bound>\d+))?>')
INTEGER = re.compile(r'(?P<sign>u?)int(?P<bits>\d+)')


def leaves(message: Any) -> Iterator[tuple[Any, str, str]]:  # noqa: ANN401
    """Yield (message, field, type) of all fields that hold no message, of nested ones too."""
    for name, kind in message.get_fields_and_field_types().items():
        held = getattr(message, name)
        inner = [held] if hasattr(held, 'get_fields_and_field_types') else []
        if not inner:
            yield message, name, kind
            inner = held[:8] if isinstance(held, list) else []
        for each in inner:
            if hasattr(each, 'get_fields_and_field_types'):
                yield from leaves(each)


def mutate(rng: Random, message: Any) -> None:  # noqa: ANN401
    """Change one field of a message, or several, to anything that their types allow."""
    places = list(leaves(message))
    count = min(len(places), 1 + int(rng.expovariate(1.0)))
    for owner, name, kind in rng.sample(places, count):
        setattr(owner, name, value(rng, kind, getattr(owner, name)))


def value(rng: Random, kind: str, held: Any = None) -> Any:  # noqa: ANN401
    """Return a value of a type, often an extreme one.

    Args:
        rng: Random numbers.
        kind: As `get_fields_and_field_types` names it.
        held: The value before, None for none.
    """
    if found := ARRAY.fullmatch(kind):
        return [value(rng, found['element']) for _ in range(int(found['count']))]
    if found := SEQUENCE.fullmatch(kind):
        if found['element'] == 'uint8':
            return array('B', octets(rng, bytes(held or b'')))
        count = min(rng.choice((0, 1, 2, 7, 100)), int(found['bound'] or 100))
        return [value(rng, found['element']) for _ in range(count)]
    return _scalar(rng, kind, held)


def _scalar(rng: Random, kind: str, held: Any) -> Any:  # noqa: ANN401
    if found := INTEGER.fullmatch(kind):
        return _integer(rng, int(found['bits']), not found['sign'], held)
    number = rng.choice((*REAL, rng.gauss(0, 1), held or 0.0))
    simple = {
        'double': number,
        'float': number if isinstance(number, float) and abs(number) < 1e38 else float('inf'),
        'octet': bytes([rng.randrange(256)]),
        'boolean': rng.random() < 0.5,
        'string': rng.choice(WORDS),
    }
    if kind in simple:
        return simple[kind]
    package, name = kind.split('/')
    message = message_class(f'{package}/msg/{name}')()
    mutate(rng, message)
    return message


def _integer(rng: Random, bits: int, signed: bool, held: int | None) -> int:
    low, high = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signed else (0, (1 << bits) - 1)
    near = (held or 0) + rng.choice((-1000, -1, 1, 2, 1000, 10**6, 10**9))
    any_size = rng.getrandbits(rng.randint(1, bits)) * (-1 if signed and rng.random() < 0.3 else 1)
    return max(low, min(high, rng.choice((0, 1, low, high, high - 1, near, any_size))))


def octets(rng: Random, held: bytes) -> bytes:
    """Return bytes that were cut, extended, flipped, repeated or replaced."""
    place = rng.randrange(len(held) + 1)
    changed = bytearray(held)
    for _ in range(min(len(held), rng.randint(1, 8))):
        changed[rng.randrange(len(held))] = rng.randrange(256)
    noise = rng.randbytes(rng.choice((0, 1, 2, 7, 64, 4096)))
    return rng.choice((held[:place], held + noise, bytes(changed), noise, 2 * held))


class Target(Protocol):
    """A node that is fuzzed, in process or over DDS."""

    def settle(self) -> None:
        """Wait until everything that it listens to is known."""

    def topics(self) -> Mapping[str, Any]:
        """Return the message types of what it subscribes to, by topic."""

    def services(self) -> Mapping[str, Any]:
        """Return the types of its services, by name."""

    def send(self, topic: str, payload: bytes) -> None:
        """Send a serialised message."""

    def ask(self, service: str, request: Any) -> Any:  # noqa: ANN401
        """Call a service and return its answer; None without one."""


SHUTDOWNS = range(5, 8)
"""Transitions after which a node cannot be used again."""
OF_PARAMETERS = '/list_parameters'
CHANGE_STATE = '/change_state'
MOST_TRANSITIONS = 100


def fuzz_target(
    target: Target,
    rng: Random,
    mutated: Callable[[Any], bytes],
    messages: int,
    requests: int,
) -> dict[str, int]:
    """Fuzz all that a node listens to: topics, services, its clock; return how much was sent.

    It is active before and afterwards, with the same parameters.

    Args:
        target: The node.
        rng: Random numbers.
        mutated: Returns a mutated message of a type, serialised.
        messages: Number of messages to each topic.
        requests: Number of requests to each service.
    """
    revive(target)
    target.settle()
    sent = _fuzz_topics(target, target.topics(), mutated, messages)
    services = dict(target.services())
    kept = _parameters(target)
    for name in sorted(services, key=lambda each: each.endswith(CHANGE_STATE)):
        count = min(requests, MOST_TRANSITIONS) if name.endswith(CHANGE_STATE) else requests
        for _ in range(count):
            _fuzz_service(target, rng, name, services[name], [each.name for each in kept])
        sent[name] = count
    use_clock = _parameter('use_sim_time', True)
    _set(target, [use_clock])
    target.settle()
    clock = {name: kind for name, kind in target.topics().items() if name == '/clock'}
    sent |= _fuzz_topics(target, clock, mutated, messages)
    _set(target, [*kept, _parameter('use_sim_time', False)])
    revive(target)
    return sent


def _fuzz_topics(
    target: Target, topics: Mapping[str, Any], mutated: Callable[[Any], bytes], messages: int
) -> dict[str, int]:
    for name, kind in topics.items():
        for _ in range(messages):
            target.send(name, mutated(kind))
    return dict.fromkeys(topics, messages)


def _fuzz_service(target: Target, rng: Random, name: str, kind: Any, names: list[str]) -> None:  # noqa: ANN401
    request = kind.Request()
    if name.endswith(('/set_parameters', '/set_parameters_atomically')):
        request.parameters = [_parameter(rng.choice([*names, 'x']), 0) for _ in range(2)]
    elif name.endswith(CHANGE_STATE):
        request.transition.id = rng.choice((1, 2, 3, 4, 10, 99, rng.randrange(256)))
    elif hasattr(request, 'names'):
        request.names = rng.sample(names, min(2, len(names)))
    if rng.random() < 0.8:
        mutate(rng, request)
    if not (name.endswith(CHANGE_STATE) and request.transition.id in SHUTDOWNS):
        target.ask(name, request)


def revive(target: Target) -> None:
    """Configure and activate a lifecycle node; others are active anyway."""
    for name, kind in target.services().items():
        if name.endswith(CHANGE_STATE):
            for transition in (4, 2, 1, 3):
                request = kind.Request()
                request.transition.id = transition
                target.ask(name, request)


def _service(target: Target, ending: str) -> tuple[str, Any]:
    return next(each for each in target.services().items() if each[0].endswith(ending))


def _parameters(target: Target) -> list[Any]:
    """Return the present parameters that can be set."""
    name, kind = _service(target, OF_PARAMETERS)
    names = target.ask(name, kind.Request()).result.names
    name, kind = _service(target, '/get_parameters')
    values = target.ask(name, kind.Request(names=names)).values
    parameter = message_class('rcl_interfaces/msg/Parameter')
    pairs = zip(names, values, strict=True)
    return [parameter(name=name, value=held) for name, held in pairs if 'qos' not in name]


def _parameter(name: str, held: bool | int) -> Any:  # noqa: ANN401
    message = message_class('rcl_interfaces/msg/Parameter')(name=name)
    if isinstance(held, bool):
        message.value.type, message.value.bool_value = 1, held
    else:
        message.value.type, message.value.integer_value = 2, held
    return message


def _set(target: Target, parameters: list[Any]) -> None:
    name, kind = _service(target, '/set_parameters')
    target.ask(name, kind.Request(parameters=parameters))


def fuzz_direct(name: str, messages: int, seed: int) -> dict[str, Any]:
    """Fuzz the callbacks of a node in a process of its own; return the figures for JSON.

    Raises:
        GraphError: The process ended.
    """
    with BenchRun() as run:
        counts = f'--messages={messages}', f'--seed={seed}', f'--folder={run.folder}'
        program = run.start_program(name, 'fuzz_node', name, *counts)
        return {'node': name, 'live': False, **program.expect('sent', LONGEST_S)}


def fuzz_live(name: str, messages: int, seed: int) -> dict[str, Any]:
    """Fuzz a node over DDS; return the figures for JSON.

    Raises:
        GraphError: The node could not be started.
    """
    with tempfile.TemporaryDirectory(prefix='mixtac-') as text, BenchRun() as run:
        folder = Path(text)
        spec, ended = nodes(folder)[name], ''
        environment = {**run.environment, 'MIXTAC_HOME': text}
        with ProcessGroup(folder / 'log', environment) as group:
            group.start(name, spec.command(NAMESPACE, log_level='warn'))
            counts = f'--messages={messages}', f'--seed={seed}', f'--folder={folder}', '--live'
            program = run.start_program('fuzz', 'fuzz_node', name, *counts)
            figures: dict[str, Any] = {'sent': {}}
            try:
                figures = program.expect('sent', LONGEST_S)
            except GraphError as error:
                ended = str(error)
            try:
                group.check()
            except GraphError as error:
                ended = str(error)
        log = (folder / 'log' / f'{name}.log').read_text(errors='replace')
        tracebacks = re.findall(r'^Traceback[^\n]*(?:\n .*)*\n(.*)', log, re.MULTILINE)
        return {'node': name, 'live': True, **figures, 'ended': ended, 'errors': tracebacks}


OptionalText = Optional[str]  # noqa: UP045  (typer evaluates this under Python 3.10)


def fuzz_nodes(
    messages: Annotated[
        int, typer.Option(min=0, help='Messages per topic in process; services get a hundredth.')
    ] = 1000,
    live: Annotated[
        int, typer.Option(min=0, help='Messages per topic over DDS; services get a tenth.')
    ] = 100,
    node: Annotated[OptionalText, typer.Option(help='Fuzz only this node.')] = None,
    seed: Annotated[int, typer.Option(min=0, help='Random seed.')] = 0,
    json: JsonFile = None,
) -> None:
    """Send random and mutated messages to every topic and service of the nodes; count failures."""
    console = Console(markup=False)
    names = [node] if node is not None else list(nodes(Path()))
    unknown = [name for name in names if name not in nodes(Path())]
    if unknown:
        raise GraphError(
            f'there is no node {unknown[0]}', remedy=f'use one of {", ".join(nodes(Path()))}'
        )
    runs = []
    with console.status('fuzzing'):
        for name in names:
            if messages and name in DIRECT:
                runs.append(fuzz_direct(name, messages, seed))
            if live:
                runs.append(fuzz_live(name, live, seed))
    headings = ('node', 'over DDS', 'topics', 'messages', 'exceptions', 'ended', 'slowest ms')
    console.print(make_table('Random and mutated messages', headings, map(_row, runs)))
    for run in runs:
        for error in [*run['errors'], *([run['ended']] if run['ended'] else [])]:
            console.print(f'{run["node"]}: {error}')
    write_json(json, {'seed': seed, 'runs': runs})
    if any(run['errors'] or run['ended'] for run in runs):
        raise typer.Exit(1)


def _row(run: Mapping[str, Any]) -> tuple[object, ...]:
    slowest = run.get('slowest_ms', {})
    return (
        run['node'],
        'yes' if run['live'] else 'no',
        len(run['sent']),
        sum(run['sent'].values()),
        len(run['errors']),
        'yes' if run['ended'] else 'no',
        f'{max(slowest.values()):.1f}' if slowest else '',
    )
