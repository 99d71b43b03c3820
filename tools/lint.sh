#!/usr/bin/env bash
# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
# Style, types, layers, and whether the generated pages are up to date.
set -eu
cd "$(dirname "$0")/.."
ruff check .
ruff format --check .
mypy src/*/mixtac_*/ tools
python tools/check_house.py
python tools/write_reference.py --check
