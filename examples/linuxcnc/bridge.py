#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""A user interface of LinuxCNC without a screen: drives to the places of a file, and writes where the machine stands.

LinuxCNC starts it, in the Python that its modules are made for; `places.json` is beside the INI file.
"""

import json
import time
from pathlib import Path

import hal
import linuxcnc

AXES = "xyz"
# Far more than any move takes here, s: a controller that hangs must not hang its user.
PATIENCE = 30.0


def main() -> None:
    """Drive, and leave `stops.json` behind: what could be reached, and the controller's own words."""
    controller = Controller()
    stops = []
    try:
        controller.home()
        for place in json.loads(Path("places.json").read_text()):
            stops.append(controller.go(place))
    finally:
        Path("stops.json").write_text(json.dumps({"stops": stops, "messages": controller.messages()}))


class Controller:
    """LinuxCNC's task, as its Python module shows it."""

    def __init__(self) -> None:
        self._command, self._status = linuxcnc.command(), linuxcnc.stat()
        self._errors, self._said = linuxcnc.error_channel(), []
        self._pins = hal.component("bridge")  # pins and signals are read by who is known to HAL
        self._pins.ready()

    def home(self) -> None:
        """Switch on, and take the place where the machine stands for zero."""
        for state in (linuxcnc.STATE_ESTOP_RESET, linuxcnc.STATE_ON):
            self._command.state(state)
            self._command.wait_complete(PATIENCE)
        self._command.home(-1)
        self._wait("homing", lambda: sum(self._status.homed) == self._status.joints)
        self._command.mode(linuxcnc.MODE_MDI)
        self._command.wait_complete(PATIENCE)

    def go(self, place: dict[str, float]) -> dict[str, dict[str, float]]:
        """Where motors and carriages are after a move to machine coordinates, mm."""
        words = " ".join(f"{axis}{value:.6f}" for axis, value in place.items())
        self._command.mdi(f"G53 G0 {words}")
        self._command.wait_complete(PATIENCE)
        self._wait(f"moving to {words}", lambda: self._stands(place))
        return {part: {axis: hal.get_value(f"{axis}-{part}") for axis in AXES} for part in ("motor", "carriage")}

    def _stands(self, place: dict[str, float]) -> bool:
        """Whether the axes are there with their corrections, for which LinuxCNC's own `in position` does not wait."""
        there = all(abs(self._pin(axis, "pos-cmd") - value) < 1e-6 for axis, value in place.items())
        return there and self._status.inpos and not any(self._pin(axis, "backlash-vel") for axis in AXES)

    def _pin(self, axis: str, name: str) -> float:
        return hal.get_value(f"joint.{AXES.index(axis)}.{name}")

    def _wait(self, what: str, done) -> None:
        end = time.monotonic() + PATIENCE
        while True:
            self._status.poll()
            if done():
                return
            if time.monotonic() > end:
                raise TimeoutError(f"{what}: not done after {PATIENCE:g} s")
            time.sleep(0.001)

    def messages(self) -> list[str]:
        """What the controller told its operator until now."""
        while found := self._errors.poll():
            self._said.append(found[1])
        return self._said


if __name__ == "__main__":
    main()
