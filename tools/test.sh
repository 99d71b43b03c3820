#!/usr/bin/env bash
# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
# All tests, or those that the arguments name: what runs in real time, one after the other, and
# beside it the calculations, two at a time, in the time that they leave. Calculations come in
# the order of collection, which begins with the slow files, so that none is left over at the end.
set -u
cd "$(dirname "$0")/.."
none=5 # pytest's status when nothing was selected
calculations=log/test_calculations.log

# Linux may share its time among sessions first, and heeds niceness only within each: hence both.
idle='echo 19 2>/dev/null >/proc/self/autogroup; exec nice -n 19 "$@"'
calculation_tests=(env OMP_NUM_THREADS=1 python -m pytest -m 'not live' --timeout 900)
calculation_tests+=(--dist loadgroup --no-loadscope-reorder --durations 25 --durations-min 5)
setsid bash -c "$idle" idle "${calculation_tests[@]}" -n 2 "$@" >"$calculations" 2>&1 &
calculating=$!
trap 'kill -- -$calculating 2>/dev/null' EXIT
trap 'exit 130' INT TERM

echo "calculations run in the background: $calculations"
# In a worker, so that one that hangs in the middleware fails alone.
live_tests=(python -m pytest -m live -n 1 --no-loadscope-reorder --dist loadgroup)
live_tests+=(-o cache_dir=.pytest_cache/live)
live_tests+=(--durations 25 --durations-min 5)
"${live_tests[@]}" "$@"
live=$?
tail -n +1 -f --pid=$calculating "$calculations"
wait $calculating
calculated=$?
if [ $calculated = $none ]; then exit $live; fi
if [ $calculated != 0 ] || [ $live = $none ]; then exit $calculated; fi
exit $live
