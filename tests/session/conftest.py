# SPDX-License-Identifier: Apache-2.0
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.folder import read_session

DATA = Path(__file__).parents[1] / "data"

DIRECT = """format: mtcal-session/1
method: direct
datum: offset
terms: [EXX]
machine: {chain: w-X-b-t, travel: {x: [0, 1]}}
standard_uncertainty: {displacement: 1e-6}
setups: [{id: fwd}]
"""
DIRECT_ROWS = "setup,x,gx,gy,gz,displacement\n" + "".join(f"fwd,{i / 10},1,0,0,{i}e-6\n" for i in range(8))


@dataclass
class Folder:
    """A session folder that a test may damage."""

    path: Path

    @property
    def described(self) -> Path:
        return self.path / "session.yaml"

    @property
    def observed(self) -> Path:
        return self.path / "observations.csv"

    def edit_yaml(self, old: str, new: str) -> None:
        text = self.described.read_text()
        assert old in text
        self.described.write_text(text.replace(old, new, 1))

    def lines(self) -> list[str]:
        return self.observed.read_text().splitlines()

    def write_lines(self, lines: list[str]) -> None:
        self.observed.write_text("\n".join(lines) + "\n")

    def edit_rows(self, change: Callable[[dict[str, str], int], dict[str, str] | None]) -> None:
        """Change every row (columns by name, number of the row); None leaves it out."""
        lines = self.lines()
        names = lines[0].split(",")
        out = [lines[0]]
        for number, line in enumerate(lines[1:]):
            row = change(dict(zip(names, line.split(","), strict=True)), number)
            if row is not None:
                out.append(",".join(row.values()))
        self.write_lines(out)

    def set_field(self, row: int, column: str, value: str) -> None:
        self.edit_rows(lambda fields, number: {**fields, column: value} if number == row else fields)

    def refusal(self) -> str:
        """What is said of the defect in one line, without how an implausible size is taken as it is."""
        with pytest.raises(SessionError) as caught:
            read_session(self.path)
        text = str(caught.value).removesuffix(" (trust_units: true in session.yaml takes it as it is)")
        assert "\n" not in text
        return text.replace(f"{self.path}/", "")

    def drop_column(self, column: str) -> None:
        lines = [line.split(",") for line in self.lines()]
        at = lines[0].index(column)
        self.write_lines([",".join(fields[:at] + fields[at + 1 :]) for fields in lines])


@pytest.fixture
def session_folder(tmp_path: Path) -> Callable[[str], Folder]:
    def make(name: str) -> Folder:
        path = tmp_path / "session"
        if name == "direct":
            path.mkdir()
            (path / "session.yaml").write_text(DIRECT)
            (path / "observations.csv").write_text(DIRECT_ROWS)
        else:
            shutil.copytree(DATA / name, path)
        return Folder(path)

    return make
