# SPDX-License-Identifier: Apache-2.0
"""The rclpy nodes; each is a program of its own.

Names in the graph are relative, so a namespace or a remapping moves all of them; msg_docs/ describes every topic.
"""

import os
import signal
import sys
from pathlib import Path

__all__: list[str] = []


def _end_quietly_until_it_runs() -> None:
    """A node that is stopped while it is still importing ends as one that runs does: status 0, not a word."""
    program = Path(sys.argv[0] if sys.argv else "").name
    script = Path(__file__).with_name(program.removeprefix("mtcal-").replace("-", "_") + ".py")
    # "-m" stands there as long as the module that is to be run is being looked for, which begins in its package: here.
    if program == "-m" or (program.startswith("mtcal-") and script.exists()):
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: os._exit(0))


_end_quietly_until_it_runs()
