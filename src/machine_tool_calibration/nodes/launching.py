# SPDX-License-Identifier: Apache-2.0
"""What the launch files check before they start anything; `launch` itself is not needed for it."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from machine_tool_calibration.errors import CalibrationError, did_you_mean

__all__ = ["switches", "unknown_arguments"]

_WORDS = {"true": True, "1": True, "yes": True, "on": True, "false": False, "0": False, "no": False, "off": False}


def switches(given: Mapping[str, str], names: Collection[str]) -> dict[str, bool]:
    """Arguments that are true or false.

    Args:
        given: text of each argument by name.
        names: of those that are wanted.

    Raises:
        CalibrationError: one is neither.
    """
    for name in names:
        if given[name].lower() not in _WORDS:
            raise CalibrationError(f"{name}:={given[name]} is neither true nor false")
    return {name: _WORDS[given[name].lower()] for name in names}


def unknown_arguments(given: Collection[str], known: Collection[str]) -> list[str]:
    """A sentence for each argument that nobody reads, which `ros2 launch` passes over without a word."""
    return [f"there is no argument {name!r}{did_you_mean(name, known)}" for name in sorted(set(given) - set(known))]
