# SPDX-License-Identifier: Apache-2.0
"""What starts a graph: parameters of its nodes, and for launch files arguments that are checked before, and nodes."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

from machine_tool_calibration.errors import CalibrationError, did_you_mean

__all__ = ["graph_parameters", "managed_nodes", "refuse_unknown", "switches"]

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


def refuse_unknown(file: str, given: Collection[str], known: Collection[str]) -> None:
    """Refuse an argument that nobody reads, which `ros2 launch` passes over without a word.

    Where another launch file includes this one its own arguments are there too: then nothing is refused.

    Args:
        file: name of the launch file.
        given: names of the arguments.
        known: names of those that it has.

    Raises:
        CalibrationError: there is one.
    """
    unknown = sorted(set(given) - set(known))
    if unknown and any(word.endswith(file) for word in sys.argv):
        name = unknown[0]
        raise CalibrationError(f"there is no argument {name!r}{did_you_mean(name, known)}; {file} --show-args has them")


def graph_parameters(
    procedure: Path | str, site: Path | str, *, simulated_time: bool, driver: str, bag: Path | str
) -> dict[str, dict[str, Any]]:
    """Parameters of the nodes of a graph, by their names.

    Args:
        procedure: file.
        site: file of what is true in the simulated workshop.
        simulated_time: whether they live by `/clock`.
        driver: of the instrument.
        bag: folder of the recording; empty: one named by the date.
    """
    common = {"use_sim_time": simulated_time}
    # one origin for all simulating nodes, whole seconds so that it is exact
    world = {**common, "site": str(site), "time_origin": float(int(time.time()))}
    return {
        "axis_simulator": world,
        "rotary_pointer": world,
        "instrument": {**world, "driver": driver},
        "probe": world,
        "estimator": {**common},
        "procedure": {**common, "procedure": str(procedure)},
        "recorder": {**common, "folder": str(bag)},
    }


def managed_nodes(
    parameters: Mapping[str, Mapping[str, Any]],
    namespace: str,
    file: str,
    on_exit: Callable[..., Any],
    *,
    autostart: bool,
) -> list[Any]:
    """The actions that start nodes of this package.

    That they go to their active state is told them by a parameter: a transition that `launch` asks for by a service is
    lost, now and then, where the node has not discovered `launch` yet.

    Args:
        parameters: of each node, by its name; they count more than those of the file.
        namespace: of all; `/clock` is remapped into it, as it is absolute and two graphs would share it.
        file: of ROS parameters.
        on_exit: called when one ends.
        autostart: whether they are configured and activated; else a lifecycle manager does it.
    """
    from launch_ros.actions import LifecycleNode

    space = namespace.strip("/")
    return [
        LifecycleNode(
            package="machine_tool_calibration",
            executable=name,
            name=name,
            namespace=space,
            parameters=[file, {**values, "autostart": autostart}],
            remappings=[("/clock", f"/{space}/clock")] if space else [],
            output="screen",
            on_exit=on_exit,
        )
        for name, values in parameters.items()
    ]
