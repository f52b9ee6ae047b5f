# SPDX-License-Identifier: Apache-2.0
"""How many targets a second the node graph captures in simulated time, and what each process costs.

    python benchmarks/graph.py [--readings 2000] [--without recorder estimator]

Every process is real: commands, states, readings and the recording go through the middleware. The rate counts from the
start of the procedure to its last reading. The processor time of each process per target says what would limit it on an
idle machine: two cores give 2 / (sum of all) targets a second at most.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from machine_tool_calibration.nodes.client import Client
from machine_tool_calibration.nodes.graph import Graph, claimed_domain
from machine_tool_calibration.nodes.shared import procedure_file

NODES = ("recorder", "axis_simulator", "rotary_pointer", "instrument", "estimator", "procedure")


def processor_time(process: int) -> float:
    """Seconds of user and system time of a process so far."""
    fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--readings", type=int, default=2000)
    parser.add_argument("--without", nargs="*", default=[], choices=("recorder", "estimator"))
    chosen = parser.parse_args()
    content = yaml.safe_load(procedure_file("tracking_3d").read_text())
    content["session"]["repeats"] = max(1, chosen.readings // 500)
    total = 500 * content["session"]["repeats"]
    names = [name for name in NODES if name not in chosen.without]
    with tempfile.TemporaryDirectory() as temporary, claimed_domain() as domain:
        folder = Path(temporary)
        (folder / "procedure.yaml").write_text(yaml.safe_dump(content))
        world: dict[str, Any] = {"use_sim_time": True, "time_origin": 1.7e9}
        special: dict[str, dict[str, Any]] = {
            "recorder": {"folder": str(folder / "bag")},
            "procedure": {"use_sim_time": True, "procedure": str(folder / "procedure.yaml")},
            "estimator": {"use_sim_time": True},
        }
        nodes = {name: special.get(name, world) for name in names}
        with Graph(nodes, folder / "log", domain) as graph, Client(domain, watch=graph.check) as operator:

            def status(operator: Client = operator) -> Mapping[str, str]:
                return operator.procedure.entries

            assert operator.wait(lambda: status().get("state") == "idle" and not status()["waiting_for"], 60.0)
            operator.wait(lambda: False, 1.0)
            before = {name: processor_time(graph.process_id(name)) for name in names}
            begin = time.perf_counter()
            operator.call("procedure/start", 10.0)
            assert operator.wait(lambda: len(operator.heard.session()[1]) >= total, 600.0)
            seconds = time.perf_counter() - begin
            cost = {name: processor_time(graph.process_id(name)) - before[name] for name in names}
            operator.wait(lambda: status()["state"] == "finished", 10.0)
            print(f"{total} targets in {seconds:.2f} s: {total / seconds:.0f} targets a second")
            print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
            for name in names:
                print(f"  {name:16} {cost[name] / total * 1e3:6.2f} ms of processor time per target")
            whole = sum(cost.values()) / total
            print(f"  {'all':16} {whole * 1e3:6.2f} ms: at most {2 / whole:.0f} targets a second on two idle cores")
            print({key: status()[key] for key in ("resent", "stale", "unstable", "recoveries", "restarts")})


if __name__ == "__main__":
    main()
