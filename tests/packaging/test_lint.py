# SPDX-License-Identifier: Apache-2.0
"""Style and types are part of the tests; those of ROS's own checkers where rosdep has installed them."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def check(*command: str) -> None:
    done = subprocess.run([sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_mypy() -> None:
    # The cache lies in the environment and goes with it: it remembers what was not installed.
    check("mypy", "--no-error-summary", "--cache-dir", str(Path(sys.prefix, "mypy_cache")))


def test_imports_run_downwards_from_room_to_room() -> None:
    linter = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run([linter, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_ruff() -> None:
    check("ruff", "check", "--no-cache", ".")


CHECKED = ("src", "tests", "launch", "examples", "setup.py")
# Those that ruff leaves out too (pyproject.toml); a private function may do without a docstring (D103), and a docstring
# may begin with what looks like a call (D402).
NOT_ASKED_FOR = ("D100", "D103", "D104", "D105", "D107", "D205", "D212", "D301", "D402")


def test_flake8(monkeypatch: pytest.MonkeyPatch) -> None:
    flake8 = pytest.importorskip("ament_flake8.main", reason="ament_flake8 comes with ROS 2")
    monkeypatch.chdir(ROOT)
    count, errors = flake8.main_with_errors(argv=["--config", "setup.cfg", *CHECKED])
    assert count == 0, "\n".join(errors)


def test_docstrings(monkeypatch: pytest.MonkeyPatch) -> None:
    pep257 = pytest.importorskip("ament_pep257.main", reason="ament_pep257 comes with ROS 2")
    monkeypatch.chdir(ROOT)
    style = ["--convention", "google", "--add-ignore", *NOT_ASKED_FOR]
    assert pep257.main(argv=[*style, "--", "src/machine_tool_calibration", "examples"]) == 0
