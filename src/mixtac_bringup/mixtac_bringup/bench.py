# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The commands of `mixtac bench`: how fast it is, against a limit or a peer of the same run."""

from __future__ import annotations

import typer

app = typer.Typer(name='bench', help='Measure the speed of the parts.', no_args_is_help=True)


def mount() -> None:
    """Add the commands; what they need takes a while to load."""
    from mixtac_bringup.benchmark.align import align
    from mixtac_bringup.benchmark.compose import compose
    from mixtac_bringup.benchmark.infer import infer
    from mixtac_bringup.benchmark.pipeline_report import pipeline
    from mixtac_bringup.benchmark.recovery import recovery
    from mixtac_bringup.benchmark.simulate_report import simulate
    from mixtac_bringup.benchmark.two_sensors import two_sensors
    from mixtac_bringup.slip_bench.slip_bench import slip
    from mixtac_driver.benchmark.decode_benchmark import decode
    from mixtac_driver.benchmark.fuzz import fuzz

    for command in (
        decode,
        pipeline,
        recovery,
        simulate,
        align,
        infer,
        compose,
        two_sensors,
        slip,
        fuzz,
    ):
        app.command()(command)
