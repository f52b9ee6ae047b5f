# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import pytest

from machine_tool_calibration.errors import CalibrationError, SessionError
from machine_tool_calibration.files import save, whole


def test_a_file_is_there_whole_and_its_folder_is_made(tmp_path: Path) -> None:
    assert save(tmp_path / "new" / "a.txt", "µm").read_text(encoding="utf-8") == "µm"
    assert save(tmp_path / "new" / "a.txt", b"\0").read_bytes() == b"\0"
    assert [file.name for file in (tmp_path / "new").iterdir()] == ["a.txt"]


def test_what_was_there_stays_if_writing_is_cut_short(tmp_path: Path) -> None:
    save(tmp_path / "a.txt", "before")
    with pytest.raises(ZeroDivisionError), whole(tmp_path / "a.txt") as part:
        part.write_text("half")
        raise ZeroDivisionError
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("a.txt", "before")]


def test_a_refusal_of_the_system_is_one_line_with_the_name_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "a.txt").mkdir()
    with pytest.raises(CalibrationError, match=r"a\.txt: cannot be written: Is a directory$"):
        save(tmp_path / "a.txt", "")
    save(tmp_path / "file", "")
    with pytest.raises(SessionError, match="file: cannot be written"), whole(tmp_path / "file" / "b", SessionError):
        pass
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.txt", "file"]
