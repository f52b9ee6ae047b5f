# SPDX-License-Identifier: Apache-2.0
"""Runs a node: `python -m machine_tool_calibration.nodes estimator`, and what `mtcal-estimator` calls."""

import os
import signal
import sys
from importlib import import_module
from pathlib import Path

from machine_tool_calibration.errors import CalibrationError

NODES = {
    "axis_simulator": "AxisSimulator", "estimator": "Estimator", "instrument": "Instrument",
    "player": "Player", "probe": "Probe", "procedure": "ProcedureNode", "recorder": "Recorder",
    "rotary_pointer": "RotaryPointer",
}  # fmt: skip
"""Class of each node, by its name, which is its module's and its executable's."""

_SAVES = ("player", "recorder")  # have something to finish when they are asked to end


def main(name: str, args: list[str]) -> int:
    """Run a node, and end the process once it has run: what it had to save is saved.

    Asked for help, it prints what the node is and takes, and starts nothing. An interpreter that tidies up, or waits
    for a calculation that nobody wants any more, could take seconds under load.

    The exit status is returned where no node was wanted, but help, or an argument is unknown.
    """
    for number in (signal.SIGINT, signal.SIGTERM):  # while it is still importing: as when it runs, not a word
        signal.signal(number, lambda *_: sys.exit(0))
    module = import_module(f"machine_tool_calibration.nodes.{name}")
    own = args[: args.index("--ros-args")] if "--ros-args" in args else args
    if "--help" in own or "-h" in own:
        return _help(name, str(module.__doc__))
    if own:
        print(f"{name}: unknown argument {own[0]!r}; parameters come after --ros-args (--help)", file=sys.stderr)
        return 2
    from machine_tool_calibration.nodes.ros.process import SAVE_GRACE, STOP_GRACE, run

    status = run(getattr(module, NODES[name]), [name, *args], grace=SAVE_GRACE if name in _SAVES else STOP_GRACE)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


def console() -> int:
    """Run the node of the executable's name: `mtcal-axis-simulator`."""
    return main(Path(sys.argv[0]).stem.removeprefix("mtcal-").replace("-", "_"), sys.argv[1:])


def _help(name: str, about: str) -> int:
    from machine_tool_calibration.nodes.shared import usage

    try:
        print(usage(name, about), flush=True)
    except BrokenPipeError:  # its reader has seen enough; what is still buffered goes nowhere
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except CalibrationError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in NODES:
        raise SystemExit(f"which node is to be run? These are {', '.join(NODES)}")
    raise SystemExit(main(sys.argv[1], sys.argv[2:]))
