# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Message classes by their type names."""

from __future__ import annotations

import importlib
from typing import Any


def message_class(type_name: str) -> Any:  # noqa: ANN401
    """Return the class of, for example, `sensor_msgs/msg/Image`."""
    package, kind, name = type_name.split('/')
    return getattr(importlib.import_module(f'{package}.{kind}'), name)
