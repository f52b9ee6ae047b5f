# SPDX-License-Identifier: Apache-2.0
"""Pages of the documentation, executed from top to bottom; what they say is printed is printed."""

import contextlib
import io
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = ("python", "budget")
NUMBER = re.compile(r"-?\d+\.\d+(?:e[-+]\d+)?")


def same(printed: str, shown: str) -> None:
    """The same words and whole numbers; a decimal may differ by one in the last place that is shown."""
    assert NUMBER.sub("#", printed).split() == NUMBER.sub("#", shown).split()
    for found, expected in zip(NUMBER.findall(printed), NUMBER.findall(shown), strict=True):
        last = 10.0 ** -len(expected.partition("e")[0].partition(".")[2])
        assert abs(float(found) - float(expected)) < 1.01 * last, f"{found} instead of {expected}"


@pytest.mark.parametrize("page", PAGES)
def test_every_block_prints_what_the_page_says(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "config").symlink_to(ROOT / "config")
    path = ROOT / "docs" / f"{page}.md"
    blocks = re.findall(r"```python\n(.*?)```\n\n```text\n(.*?)```\n", path.read_text(encoding="utf-8"), re.S)
    assert len(blocks) == path.read_text(encoding="utf-8").count("```python")
    names: dict[str, object] = {}
    for code, shown in blocks:
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            exec(compile(code, str(path), "exec"), names)
        same(out.getvalue(), shown)
    if page == "python":
        assert (tmp_path / "error_map.png").read_bytes().startswith(b"\x89PNG")
