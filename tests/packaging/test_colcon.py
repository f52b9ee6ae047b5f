# SPDX-License-Identifier: Apache-2.0
"""A workspace build, where colcon is installed."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = "machine_tool_calibration"
PATH = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)])
COLCON = shutil.which("colcon", path=PATH)


@pytest.mark.skipif(COLCON is None, reason="colcon is not installed")
@pytest.mark.parametrize("option", ["--merge-install", "--symlink-install"])
def test_workspace(source: Path, tmp_path: Path, option: str) -> None:
    shutil.copytree(source, tmp_path / "src" / PACKAGE, symlinks=True)

    def run(*command: str) -> str:
        done = subprocess.run(
            command, cwd=tmp_path, env={**os.environ, "PATH": PATH}, capture_output=True, text=True, timeout=900
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    run("colcon", "build", option)
    prefix = tmp_path / "install" / ("" if option == "--merge-install" else PACKAGE)
    assert (prefix / "share" / "ament_index" / "resource_index" / "packages" / PACKAGE).exists()
    assert os.access(prefix / "lib" / PACKAGE / "estimator", os.X_OK)
    said = run("sh", "-c", ". install/setup.sh && mtcal --version && echo $AMENT_PREFIX_PATH")
    assert said.startswith("mtcal ")
    assert str(prefix).rstrip("/") in said
