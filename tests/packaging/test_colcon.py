"""A workspace build, where colcon is installed."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

PACKAGE = "machine_tool_calibration"


@pytest.mark.skipif(shutil.which("colcon") is None, reason="colcon is not installed")
@pytest.mark.parametrize("option", ["--merge-install", "--symlink-install"])
def test_workspace(source: Path, tmp_path: Path, option: str) -> None:
    shutil.copytree(source, tmp_path / "src" / PACKAGE, symlinks=True)
    build = subprocess.run(["colcon", "build", option], cwd=tmp_path, capture_output=True, text=True, timeout=240)
    assert build.returncode == 0, build.stdout + build.stderr
    prefix = tmp_path / "install" / ("" if option == "--merge-install" else PACKAGE)
    assert (prefix / "share" / "ament_index" / "resource_index" / "packages" / PACKAGE).exists()
    assert os.access(prefix / "lib" / PACKAGE / "estimator", os.X_OK)
    command = ". install/setup.sh && mtcal --version && echo $AMENT_PREFIX_PATH"
    done = subprocess.run(["sh", "-c", command], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.startswith("mtcal ")
    assert str(prefix).rstrip("/") in done.stdout
