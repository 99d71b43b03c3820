#!/usr/bin/env bash
# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
# All tests, or those that the arguments name: calculations two at a time, then what runs in real
# time, one after the other, so that nothing starves on a computer with two cores. Calculations come
# in the order of collection, which begins with the slow files, so that none is left over at the end.
set -u
cd "$(dirname "$0")/.."
none=5 # pytest's status when nothing was selected
python -m pytest -m 'not live' -n 2 --dist loadgroup --no-loadscope-reorder "$@"
calculated=$?
python -m pytest -m live "$@"
live=$?
if [ $calculated = $none ]; then exit $live; fi
if [ $calculated != 0 ] || [ $live = $none ]; then exit $calculated; fi
exit $live
