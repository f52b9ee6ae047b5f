# SPDX-License-Identifier: Apache-2.0
"""Every command of a guide works, in the order in which it stands there."""

import re
import shlex
import shutil
from pathlib import Path

import pytest

from machine_tool_calibration.cli.main import run

ROOT = Path(__file__).parents[2]
GUIDES = sorted((ROOT / "docs" / "guides").glob("*.md"))


@pytest.mark.usefixtures("rough_pictures")
@pytest.mark.parametrize("guide", GUIDES, ids=lambda guide: guide.stem)
def test_a_guide_runs_from_top_to_bottom(guide: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for procedure in (ROOT / "config" / "procedures").glob("*.yaml"):
        shutil.copy(procedure, tmp_path)
    monkeypatch.chdir(tmp_path)
    text = guide.read_text(encoding="utf-8")
    for name, content in re.findall(r"^```\w+ (\S+\.\w+)\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        Path(name).write_text(content, encoding="utf-8")
    lines = [
        line
        for block in re.findall(r"^```bash\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
        for line in block.splitlines()
    ]
    commands = [shlex.split(line, comments=True) for line in lines if line.strip()]
    assert commands
    for verb, *arguments in commands:
        assert verb == "mtcal"
        assert run(arguments) == 0, shlex.join(arguments)
