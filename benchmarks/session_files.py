# SPDX-License-Identifier: Apache-2.0
"""Session folders with many rows: seconds to write and to read, beside pandas.

python benchmarks/session_files.py -n 1000000
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from machine_tool_calibration.session.description import Direct
from machine_tool_calibration.session.folder import read_session, readings_frame, write_session
from machine_tool_calibration.session.parse import parse_description
from machine_tool_calibration.session.session import Readings, Session

DESCRIPTION = """format: mtcal-session/1
method: direct
datum: rigid
machine: {chain: w-Y-X-b-Z-t}
standard_uncertainty: {displacement: 1e-6}
setups: [{id: plate}]
"""


def session(count: int) -> Session:
    """Points of a grid with readings, temperatures and times of full precision."""
    rng = np.random.default_rng(0)
    description = parse_description(DESCRIPTION, "session.yaml")
    assert isinstance(description, Direct)
    columns: dict[str, Any] = {"time": np.arange(count) * 0.0123}
    columns |= {axis: rng.integers(0, 51, count) * 0.02 for axis in "xyz"}
    columns |= {f"dir_{axis}": rng.choice([-1.0, 1.0], count) for axis in "xyz"}
    sensed = rng.integers(0, 3, count)
    columns |= {f"g{axis}": (sensed == j).astype(float) for j, axis in enumerate("xyz")}
    columns |= {f"temperature_{place}": 20 + rng.normal(size=count) for place in ("air", "x", "y", "z", "table")}
    readings = Readings(
        setup=np.zeros(count, dtype=np.int64),
        repeat=np.zeros(count, dtype=np.int64),
        displacement=rng.normal(size=count) * 1e-5,
        columns=columns,
        labels={},
        row=np.arange(count),
    )
    return Session(description, readings)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-n", type=int, default=1_000_000, help="rows")
    count = parser.parse_args().n
    made = session(count)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "session"
        times = [time.process_time()]
        write_session(made, path)
        times.append(time.process_time())
        back = read_session(path, check=False)
        times.append(time.process_time())
        readings_frame(made).to_csv(Path(folder) / "pandas.csv", index=False, lineterminator="\n")
        times.append(time.process_time())
        same = (path / "observations.csv").read_bytes() == (Path(folder) / "pandas.csv").read_bytes()
        size = (path / "observations.csv").stat().st_size
    assert back.readings.displacement.tobytes() == made.readings.displacement.tobytes()
    for name, values in made.readings.columns.items():
        assert back.readings.columns[name].tobytes() == values.tobytes(), name
    write, read, pandas = np.diff(times)
    print(f"{count} rows, {size / 1e6:.0f} MB, {'the same bytes as' if same else 'other bytes than'} pandas")
    print(f"processor time: write {write:.2f} s (pandas {pandas:.2f} s), read {read:.2f} s")


if __name__ == "__main__":
    main()
