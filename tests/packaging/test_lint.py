# SPDX-License-Identifier: Apache-2.0
"""Style and types are part of the tests."""

import subprocess
import sys
from pathlib import Path

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
