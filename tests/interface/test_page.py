# SPDX-License-Identifier: Apache-2.0
"""Pages of the documentation, executed from top to bottom; what they say is printed is printed.
Importing the package costs nothing, and a type checker sees what is there all the same.
"""

import ast
import contextlib
import io
import re
import subprocess
import sys
from functools import cached_property
from pathlib import Path
from types import FunctionType

import pytest

import machine_tool_calibration as mtcal

ROOT = Path(__file__).parents[2]
PAGES = ("python", "budget")
NUMBER = re.compile(r"-?\d+\.\d+(?:e[-+]\d+)?")


def same(printed: str, shown: str) -> None:
    """The same words and whole numbers; a decimal may differ by one in the last place that is shown."""
    assert NUMBER.sub("#", printed).split() == NUMBER.sub("#", shown).split()
    for found, expected in zip(NUMBER.findall(printed), NUMBER.findall(shown), strict=True):
        last = 10.0 ** -len(expected.partition("e")[0].partition(".")[2])
        assert abs(float(found) - float(expected)) < 1.01 * last, f"{found} instead of {expected}"


@pytest.mark.long
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


NAMES = sorted({*mtcal.__all__} - {"__version__"})
HEAVY = {"numpy", "scipy", "pandas", "matplotlib", "pydantic", "click", "rich", "yaml", "pint", "rosbags"}


def loaded_after(code: str) -> set[str]:
    """First names of the modules that are loaded after some code, in a Python of its own."""
    show = f"{code}\nimport sys\nprint(*{{name.split('.')[0] for name in sys.modules}})"
    done = subprocess.run([sys.executable, "-c", show], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_the_import_loads_nothing_else() -> None:
    assert "machine_tool_calibration" in loaded_after("import machine_tool_calibration")
    assert not HEAVY & loaded_after("import machine_tool_calibration; dir(machine_tool_calibration)")


def test_every_public_name_is_there_and_has_a_docstring() -> None:
    assert set(mtcal.__all__) <= set(dir(mtcal))
    for name in NAMES:
        found = getattr(mtcal, name)
        assert found.__name__ == name
        assert found.__doc__
        for method, said in vars(found).items():
            if not method.startswith("_") and isinstance(said, FunctionType | property | cached_property):
                assert said.__doc__, f"{name}.{method}"


def test_the_type_checker_is_told_the_same_homes() -> None:
    tree = ast.parse(Path(str(mtcal.__file__)).read_text(encoding="utf-8"))
    package = mtcal.__name__
    told = {
        alias.name: str(node.module).removeprefix(f"{package}.")
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith(package)
        for alias in node.names
        if alias.name in NAMES
    }
    assert told == mtcal._HOME  # type: ignore[attr-defined]
    assert sorted(told) == NAMES


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'calibrate'"):
        mtcal.calibrate  # type: ignore[attr-defined]  # noqa: B018


def test_the_reference_holds_every_public_name() -> None:
    page = (Path(__file__).parents[2] / "docs" / "reference.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"^\.\. auto\w+:: (\w+)$", page, re.MULTILINE)) == NAMES
