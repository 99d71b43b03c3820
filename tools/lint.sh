#!/usr/bin/env bash
# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
# Style, types, layers, links, and whether the generated pages are up to date.
set -eu
cd "$(dirname "$0")/.."
mypy src/*/mixtac*/ tools &
types=$!
trap wait EXIT # what mypy finds is shown although another check has failed
ruff check .
ruff format --check .
python tools/check_house.py
python tools/check_links.py
python tools/write_reference.py --check
wait $types
