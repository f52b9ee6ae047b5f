# SPDX-License-Identifier: Apache-2.0
"""Sessions of a small fleet, and entries of a logbook as they would be found."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate
from machine_tool_calibration.trends.logbook import Entry
from machine_tool_calibration.trends.statement import Size


@pytest.fixture(scope="session")
def measurements(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`lathe/2026-01-05` by ISO 230-2, `mill/2026-01-06` in the plane, and one whose table is broken."""
    folder = tmp_path_factory.mktemp("measurements")
    for name, preset in (("lathe/2026-01-05", "iso230_2"), ("mill/2026-01-06", "tracking_2d"), ("mill/x", "iso230_2")):
        write_session(simulate(SimulationSpec(plan=PRESETS[preset], seed=2)).session, folder / name)
    with (folder / "mill/x/observations.csv").open("a", encoding="utf-8") as table:
        table.write("1.0,oops\n")
    return folder


@pytest.fixture
def entries() -> Callable[..., tuple[Entry, ...]]:
    """Monthly entries of a machine, of the values of one error, m, with a standard uncertainty."""

    def made(machine: str, values: Sequence[float], u: float = 1e-7, **more: Any) -> tuple[Entry, ...]:
        return tuple(
            Entry(
                number=k + 1,
                machine=machine,
                date=f"2026-{k + 1:02d}-05",
                instrument="laser",
                label=f"{machine}/{k:02d}",
                sha256=f"{machine}{k}",
                software="mtcal",
                result={"method": "direct", "model": "direct", "effects": []},
                sizes=(
                    Size("EXX", value, u, "m"),
                    Size("volumetric", 2.0 * value, u / 2.0, "m"),
                    Size("C0Y", 1e-6, 1e-6, "rad"),
                ),
                description="",
                readings="",
                **more,
            )
            for k, value in enumerate(values)
        )

    return made
