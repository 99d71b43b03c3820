# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bare pointers for compiled code.

A compiled function counts a reference, with an atomic instruction, for nearly every array argument
of every call that is not folded away, and every index is tested for being negative. In a loop that
calls for single words, that costs ten times what the words cost. Pointers cost nothing, and their
users answer for every index.
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array


def _codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ANN401
    return make_array(signature.args[0])(context, builder, args[0]).data


@intrinsic
def pointer_to(typingctx: Any, array: Any) -> Any:  # noqa: ANN401, ARG001
    """Return a pointer to the first element of a contiguous array; for compiled code.

    It can be indexed like a one-dimensional array that has no length. The caller must hold the
    array for as long as the pointer is used.
    """
    return types.CPointer(array.dtype)(array), _codegen
