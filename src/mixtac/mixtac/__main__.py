# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Entry point of `mixtac` and `python -m mixtac`; Ctrl-C ends them with one line at any time."""

from __future__ import annotations

import os
import signal
import sys


def _leave(_number: int, _frame: object) -> None:
    os.write(2, b'interrupted\n')
    os._exit(130)


def main() -> int:
    """Run the command line; return its exit status."""
    # Where it is ignored, as in a job in the background, it stays so.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _leave)
    # Some starters block it until here, because Python itself would end with a traceback.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    from mixtac.main import main as run

    return run()


if __name__ == '__main__':
    sys.exit(main())
