# SPDX-License-Identifier: Apache-2.0
import importlib.util
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from ..coarse import found_once, rough_pictures

__all__ = ["found_once", "rough_pictures"]

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def bootstrap() -> ModuleType:
    """The module scripts/bootstrap.py."""
    spec = importlib.util.spec_from_file_location("bootstrap", ROOT / "scripts" / "bootstrap.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def source(tmp_path_factory: pytest.TempPathFactory, bootstrap: ModuleType) -> Path:
    """A copy of what is built, so that no build touches the checkout."""
    folder = tmp_path_factory.mktemp("source") / "machine_tool_calibration"
    folder.mkdir()
    ignore = shutil.ignore_patterns(*bootstrap.NOT_SOURCES)
    for name in bootstrap.SOURCES:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, symlinks=True, ignore=ignore)
        elif (ROOT / name).exists():
            shutil.copy2(ROOT / name, folder)
    return folder


@pytest.fixture(scope="session")
def wheel(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[zipfile.ZipFile]:
    """The package as a wheel."""
    target = tmp_path_factory.mktemp("wheel")
    build = (
        "import sys, setuptools.build_meta as backend; "
        f"sys.argv = ['setup.py']; print(backend.build_wheel({str(target)!r}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", build], cwd=source, capture_output=True, text=True, timeout=900, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    with zipfile.ZipFile(next(target.glob("*.whl"))) as archive:
        yield archive
