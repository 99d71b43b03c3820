# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Pressing chosen lanes of a vector of 32 words together, the way this processor does it best.

One instruction with AVX-512 VBMI2, eight with BMI2, and lane by lane on any other processor.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from llvmlite import binding, ir
from numba.core import cgutils, config

if TYPE_CHECKING:
    from collections.abc import Callable

LANES: Final = 32
COMPRESSING_LLVM: Final = (19, 0, 0)
"""The first compiler that knows the operation."""
SLOW_BMI2: Final = frozenset({'bdver4', 'znver1', 'znver2'})
"""Processors that take hundreds of cycles for it."""

_BIT, _WORD, _LONG, _INDEX = (ir.IntType(n) for n in (1, 16, 64, 32))
_BITS, _WORDS = (ir.VectorType(t, LANES) for t in (_BIT, _WORD))
_QUADS = ir.VectorType(_LONG, LANES // 4)

Value = Any
Builder = Any


def press_at_once(builder: Builder, lanes: Value, bits: Value) -> Value:
    """Return the lanes that are set, side by side; those behind them mean nothing."""
    name = f'llvm.experimental.vector.compress.v{LANES}i16'
    kind = ir.FunctionType(_WORDS, [_WORDS, _BITS, _WORDS])
    compress = cgutils.get_or_insert_function(builder.module, kind, name)
    return builder.call(compress, [lanes, bits, ir.Constant(_WORDS, ir.Undefined)])


def press_by_fours(builder: Builder, lanes: Value, bits: Value) -> Value:
    """Return the same, four lanes at a time."""
    kind = ir.FunctionType(_LONG, [_LONG, _LONG])
    extract = cgutils.get_or_insert_function(builder.module, kind, 'llvm.x86.bmi.pext.64')
    masks = builder.bitcast(builder.sext(bits, _WORDS), _QUADS)
    quads = builder.bitcast(lanes, _QUADS)
    room, place = _room(builder), _LONG(0)
    for k in range(LANES // 4):
        mask = builder.extract_element(masks, _INDEX(k))
        pressed = builder.call(extract, [builder.extract_element(quads, _INDEX(k)), mask])
        target = builder.bitcast(builder.gep(room, [place]), _LONG.as_pointer())
        builder.store(pressed, target, align=2)
        place = builder.add(place, builder.lshr(builder.ctpop(mask), _LONG(4)))
    return _load(builder, room)


def press_one_by_one(builder: Builder, lanes: Value, bits: Value) -> Value:
    """Return the same, one lane at a time."""
    room, place = _room(builder), _LONG(0)
    for k in range(LANES):
        builder.store(builder.extract_element(lanes, _INDEX(k)), builder.gep(room, [place]))
        bit = builder.extract_element(bits, _INDEX(k))
        place = builder.add(place, builder.zext(bit, _LONG))
    return _load(builder, room)


def _room(builder: Builder) -> Value:
    # Three more than fit, for four at a time behind all the rest.
    room = cgutils.alloca_once(builder, ir.ArrayType(_WORD, LANES + 3))
    return builder.bitcast(room, _WORD.as_pointer())


def _load(builder: Builder, room: Value) -> Value:
    return builder.load(builder.bitcast(room, _WORDS.as_pointer()), align=2)


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
