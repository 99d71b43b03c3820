# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Event words decoded 32 at a time with vector instructions.

The latest time stamp and row address before each word come from a prefix scan: in five steps, each
lane takes over what the lane 1, 2, 4, 8 and 16 places before it knows. The lanes that hold events
are then packed together, with one instruction on AVX-512 VBMI2, eight on BMI2, and lane by lane on
any other processor. Written in LLVM vector types because no Python loop compiles to this.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from llvmlite import binding, ir
from numba import types
from numba.core import cgutils, config
from numba.extending import intrinsic

if TYPE_CHECKING:
    from collections.abc import Callable


LANES: Final = 32
COMPRESSING_LLVM: Final = (19, 0, 0)
"""The first compiler that knows the operation."""
SLOW_BMI2: Final = frozenset({'bdver4', 'znver1', 'znver2'})
"""Processors that take hundreds of cycles for it."""
_I1, _I16, _I64, _I32 = (ir.IntType(n) for n in (1, 16, 64, 32))
_I1S, _I16S = (ir.VectorType(t, LANES) for t in (_I1, _I16))
_QUADS = ir.VectorType(_I64, LANES // 4)
Value = Any
Builder = Any


def press_at_once(builder: Builder, lanes: Value, bits: Value) -> Value:
    """Return the lanes that are set, side by side; those behind them mean nothing."""
    name = f'llvm.experimental.vector.compress.v{LANES}i16'
    kind = ir.FunctionType(_I16S, [_I16S, _I1S, _I16S])
    compress = cgutils.get_or_insert_function(builder.module, kind, name)
    return builder.call(compress, [lanes, bits, ir.Constant(_I16S, ir.Undefined)])


def press_by_fours(builder: Builder, lanes: Value, bits: Value) -> Value:
    """Return the same, four lanes at a time."""
    kind = ir.FunctionType(_I64, [_I64, _I64])
    extract = cgutils.get_or_insert_function(builder.module, kind, 'llvm.x86.bmi.pext.64')
    masks = builder.bitcast(builder.sext(bits, _I16S), _QUADS)
    quads = builder.bitcast(lanes, _QUADS)
    room, place = _room(builder), _I64(0)
    for k in range(LANES // 4):
        mask = builder.extract_element(masks, _I32(k))
        pressed = builder.call(extract, [builder.extract_element(quads, _I32(k)), mask])
        target = builder.bitcast(builder.gep(room, [place]), _I64.as_pointer())
        builder.store(pressed, target, align=2)
        place = builder.add(place, builder.lshr(builder.ctpop(mask), _I64(4)))
    return _load(builder, room)


def press_one_by_one(builder: Builder, lanes: Value, bits: Value) -> Value:
    """Return the same, one lane at a time."""
    room, place = _room(builder), _I64(0)
    for k in range(LANES):
        builder.store(builder.extract_element(lanes, _I32(k)), builder.gep(room, [place]))
        bit = builder.extract_element(bits, _I32(k))
        place = builder.add(place, builder.zext(bit, _I64))
    return _load(builder, room)


def _room(builder: Builder) -> Value:
    # Three more than fit, for four at a time behind all the rest.
    room = cgutils.alloca_once(builder, ir.ArrayType(_I16, LANES + 3))
    return builder.bitcast(room, _I16.as_pointer())


def _load(builder: Builder, room: Value) -> Value:
    return builder.load(builder.bitcast(room, _I16S.as_pointer()), align=2)


def _best() -> Callable[[Builder, Value, Value], Value]:
    if config.CPU_NAME or config.CPU_FEATURES:  # compiled for some other processor
        return press_one_by_one
    features = binding.get_host_cpu_features()
    if features.get('avx512vbmi2') and binding.llvm_version_info >= COMPRESSING_LLVM:
        return press_at_once
    if features.get('bmi2') and binding.get_host_cpu_name() not in SLOW_BMI2:
        return press_by_fours
    return press_one_by_one


press: Callable[[Builder, Value, Value], Value] = _best()
MAX_ROWS: Final = 1024
"""Row address and number of the lane share 16 bits."""
_BIT, _BYTE, _WORD, _LONG = (ir.IntType(n) for n in (1, 8, 16, 64))
_MASK = ir.IntType(LANES)
_BITS, _BYTES, _WORDS, _LONGS = (ir.VectorType(t, LANES) for t in (_BIT, _BYTE, _WORD, _LONG))
SCALARS: Final = ('i', 'n', 'offset', 'stamp', 'row', 'rows', 'columns')
Pair = tuple[Any, Any]


def _all(kind: ir.VectorType, value: int) -> ir.Constant:
    return ir.Constant(kind, [value] * LANES)


def _spread(builder: Builder, value: Value, kind: ir.VectorType) -> Value:
    """Return a vector with the value in every lane."""
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), value, _MASK(0))
    lanes = ir.Constant(ir.VectorType(_MASK, LANES), [0] * LANES)
    return builder.shuffle_vector(one, one, lanes)


def _earlier(builder: Builder, lanes: Value, distance: int) -> Value:
    """Return the lanes moved up by a distance, zeros in front."""
    zero = _all(_WORDS, 0)
    order = [max(LANES + k - distance, 0) if k >= distance else 0 for k in range(LANES)]
    places = ir.Constant(ir.VectorType(_MASK, LANES), order)
    return builder.shuffle_vector(zero, lanes, places)


def _larger(builder: Builder, a: Value, b: Value) -> Value:
    return builder.select(builder.icmp_unsigned('>', a, b), a, b)


def _running_maximum(builder: Builder, lanes: Value, before: Value) -> Value:
    """Return for every lane the maximum of it, those before it, and that of another vector."""
    for distance in (1, 2, 4, 8, 16):
        lanes = _larger(builder, _earlier(builder, lanes, distance), lanes)
    return _larger(builder, before, lanes)


def _latest_row(builder: Builder, words: Value, rows: Value, row: Value) -> Value:
    """Return for every lane the latest row, under the number of the lane that it came in."""
    lanes = ir.Constant(_WORDS, [(k + 1) * MAX_ROWS for k in range(LANES)])
    address = builder.and_(words, _all(_WORDS, MAX_ROWS - 1))
    numbered = builder.select(rows, builder.or_(address, lanes), _all(_WORDS, 0))
    return _running_maximum(builder, numbered, row)


def _count(builder: Builder, bits: Value) -> Value:
    return builder.zext(builder.ctpop(builder.bitcast(bits, _MASK)), _LONG)


def _place(builder: Builder, data: Value, index: Value, kind: ir.VectorType) -> Value:
    return builder.bitcast(builder.gep(data, [index]), kind.as_pointer())


class _Lanes:
    """What 32 words are, and the latest stamp and row at each of them."""

    def __init__(self, builder: Builder, words: Value, limits: Pair, before: Pair) -> None:
        row_address = builder.sub(words, _all(_WORDS, 0x1000))
        column = builder.sub(builder.and_(words, _all(_WORDS, 0xEFFF)), _all(_WORDS, 0x2000))
        self.rows = builder.icmp_unsigned('<', row_address, limits[0])
        self.events = builder.icmp_unsigned('<', column, limits[1])
        stamps = builder.icmp_signed('<', words, _all(_WORDS, 0))
        usual = builder.or_(stamps, builder.or_(self.rows, self.events))
        self.all_usual = builder.icmp_signed('==', builder.bitcast(usual, _MASK), _MASK(-1))
        # Only stamps have the top bit set: the largest word is the latest stamp, never set back.
        self.stamp = _running_maximum(builder, words, before[0])
        self.late = builder.and_(stamps, builder.icmp_unsigned('<', words, self.stamp))
        self.row = _latest_row(builder, words, self.rows, before[1])

    def last(self, builder: Builder) -> Pair:
        """Return the last stamp and row, each in every lane."""
        lanes = ir.Constant(ir.VectorType(_MASK, LANES), [LANES - 1] * LANES)
        stamp, row = (builder.shuffle_vector(v, v, lanes) for v in (self.stamp, self.row))
        return stamp, builder.and_(row, _all(_WORDS, MAX_ROWS - 1))


def _write(
    builder: Builder, words: Value, lanes: _Lanes, outputs: list[Value], offset: Value, n: Value
) -> None:
    """Write the events of 32 words behind the n that are there."""
    events = press(builder, words, lanes.events)
    t = builder.add(builder.zext(press(builder, lanes.stamp, lanes.events), _LONGS), offset)
    row = builder.and_(press(builder, lanes.row, lanes.events), _all(_WORDS, MAX_ROWS - 1))
    column = builder.and_(events, _all(_WORDS, 0xFFF))
    polarity = builder.and_(builder.lshr(events, _all(_WORDS, 12)), _all(_WORDS, 1))
    values = (t, row, column, builder.trunc(polarity, _BYTES))
    for value, data, kind in zip(values, outputs, (_LONGS, _WORDS, _WORDS, _BYTES), strict=True):
        builder.store(value, _place(builder, data, n, kind), align=1)


def _loop(
    builder: Builder, words: Value, outputs: list[Value], ends: Pair, scalars: dict[str, Value]
) -> list[Value]:
    """Build the loop; return what `take_vectors` returns."""
    spread = {k: _spread(builder, scalars[k], _WORDS) for k in ('stamp', 'row', 'rows', 'columns')}
    offset = _spread(builder, scalars['offset'], _LONGS)
    start = builder.block
    head, body, onward, done = (builder.append_basic_block() for _ in range(4))
    builder.branch(head)

    builder.position_at_end(head)
    first = [scalars['i'], scalars['n'], _LONG(0), _LONG(0), spread['stamp'], spread['row']]
    now = [builder.phi(value.type) for value in first]
    for phi, value in zip(now, first, strict=True):
        phi.add_incoming(value, start)
    i, n, row_count, late_count, stamp, row = now
    room = [
        builder.icmp_signed('<=', builder.add(k, _LONG(LANES)), end)
        for k, end in zip((i, n), ends, strict=True)
    ]
    builder.cbranch(builder.and_(*room), body, done)

    builder.position_at_end(body)
    source = builder.load(_place(builder, words, i, _WORDS), align=1)
    lanes = _Lanes(builder, source, (spread['rows'], spread['columns']), (stamp, row))
    # Written before it is known whether all words are usual: so nothing waits for that. What is
    # behind the last event means nothing.
    _write(builder, source, lanes, outputs, offset, n)
    builder.cbranch(lanes.all_usual, onward, done)

    builder.position_at_end(onward)
    then = [
        builder.add(i, _LONG(LANES)),
        builder.add(n, _count(builder, lanes.events)),
        builder.add(row_count, _count(builder, lanes.rows)),
        builder.add(late_count, _count(builder, lanes.late)),
        *lanes.last(builder),
    ]
    for phi, value in zip(now, then, strict=True):
        phi.add_incoming(value, onward)
    builder.branch(head)

    builder.position_at_end(done)
    last = [builder.zext(builder.extract_element(v, _MASK(0)), _LONG) for v in (stamp, row)]
    return [i, n, row_count, late_count, *last]


def _codegen(context: Any, builder: Builder, signature: Any, args: Any) -> Any:  # noqa: ANN401
    words, size, *outputs, capacity = args[:7]
    scalars = dict(zip(SCALARS, args[7:], strict=True))
    for name in ('stamp', 'row', 'rows', 'columns'):
        scalars[name] = builder.trunc(scalars[name], _WORD)
    found = _loop(builder, words, outputs, (size, capacity), scalars)
    return context.make_tuple(builder, signature.return_type, found)


@intrinsic
def take_vectors(
    typingctx: Any,  # noqa: ANN401, ARG001
    words: Any,  # noqa: ANN401
    size: Any,  # noqa: ANN401, ARG001
    t_out: Any,  # noqa: ANN401
    row_out: Any,  # noqa: ANN401
    column_out: Any,  # noqa: ANN401
    polarity_out: Any,  # noqa: ANN401
    capacity: Any,  # noqa: ANN401, ARG001
    i: Any,  # noqa: ANN401, ARG001
    n: Any,  # noqa: ANN401, ARG001
    offset: Any,  # noqa: ANN401, ARG001
    stamp: Any,  # noqa: ANN401, ARG001
    row: Any,  # noqa: ANN401, ARG001
    rows: Any,  # noqa: ANN401, ARG001
    columns: Any,  # noqa: ANN401, ARG001
) -> Any:  # noqa: ANN401
    """Take words 32 at a time, as long as all 32 are stamps or addresses in the array.

    Args:
        typingctx: Of the compiler.
        words: Pointer to `uint16` [size], the stream.
        size: Words.
        t_out: Pointer to `int64` [capacity], event times [us].
        row_out: Pointer to `uint16` [capacity], event rows.
        column_out: Pointer to `uint16` [capacity], event columns.
        polarity_out: Pointer to `uint8` [capacity], 1 for ON.
        capacity: Events that the outputs hold.
        i: Index of the first word.
        n: Events already in the output; what lies behind them is overwritten.
        offset: Time of a stamp less its word [us].
        stamp: Latest stamp, 0x8000 or more.
        row: Latest row.
        rows: Rows of the array, MAX_ROWS at most.
        columns: Columns of the array.

    Returns:
        Index of the next word; events in the output; rows taken; stamps taken that would have set
        the time back; latest stamp; latest row.
    """
    long = types.int64
    outputs = (t_out, row_out, column_out, polarity_out)
    result = types.UniTuple(long, 6)
    return result(words, long, *outputs, long, *[long] * len(SCALARS)), _codegen
