#!/usr/bin/env bash
# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
# Healthy: a force arrives (force), or the page of the live view answers (view).
set -e
case "${1:-force}" in
    force)
        exec entrypoint.sh python "$MIXTAC_ROOT/docker/await_force.py"
        ;;
    view)
        exec python3 -c "import urllib.request as u; u.urlopen('http://127.0.0.1:${2:-9090}', timeout=5)"
        ;;
    *)
        echo "healthcheck.sh $1: use force or view" >&2
        exit 2
        ;;
esac
