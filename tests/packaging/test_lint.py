"""Style and types are part of the tests."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def check(*command: str) -> None:
    done = subprocess.run([sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr


def test_ruff() -> None:
    check("ruff", "check", "--no-cache", ".")


@pytest.mark.timeout(600)
def test_mypy() -> None:
    # Without its cache, which remembers what was not installed in another environment.
    check("mypy", "--no-error-summary", "--cache-dir", os.devnull)
