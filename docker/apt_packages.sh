#!/usr/bin/env bash
# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
# Prints the Debian packages that rosdep finds for the packages of a folder, Python modules left out.
set -euo pipefail
folder=$1
python_keys=$(grep -rhoP '(?<=depend>)python3-[^<]+' "$folder"/*/package.xml | sort -u | tr '\n' ' ')
rosdep install --simulate --reinstall --default-yes --ignore-src --from-paths "$folder" \
    --dependency-types exec --skip-keys "$python_keys" \
    | sed -n 's/^ *apt-get install -y //p' | tr ' ' '\n' | sort -u
