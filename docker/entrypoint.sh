#!/usr/bin/env bash
# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
# Runs a command in Mixtac's environment, as the process that gets the container's signals.
set -e
if [ -n "${ROS_DISTRO:-}" ]; then
    # shellcheck disable=SC1090,SC1091
    . "/opt/ros/$ROS_DISTRO/setup.bash"
fi
# shellcheck disable=SC1091
. "$MIXTAC_ROOT/tools/env.sh"
if [ "${1:-}" = mixtac ]; then
    shift
    exec python -m mixtac "$@"
fi
exec "$@"
