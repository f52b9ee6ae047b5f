# SPDX-License-Identifier: Apache-2.0
import ast
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "scripts" / "bootstrap.py"


def test_reads_on_an_old_python() -> None:
    """So that it can say that it needs a newer one."""
    ast.parse(SCRIPT.read_text(), feature_version=(3, 7))


@pytest.mark.parametrize("words", [[], ["nonsense"]])
def test_a_wrong_command_line_gives_the_usage(words: list[str]) -> None:
    done = subprocess.run([sys.executable, SCRIPT, *words], capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 2
    assert "bootstrap.py demo" in done.stderr


def test_variables_of_ros_wheels_are_not_handed_on(
    bootstrap: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "pyvenv.cfg").touch()
    libraries = [f"{tmp_path}/lib", f"{tmp_path}/lib/python3.11/site-packages/ros_x.libs", "/opt/ros/jazzy/lib"]
    monkeypatch.setenv("LD_LIBRARY_PATH", os.pathsep.join(libraries))
    monkeypatch.setenv(bootstrap.WHEELS_MARK, "1")
    environment = bootstrap.clean_environment()
    assert bootstrap.WHEELS_MARK not in environment
    assert environment["LD_LIBRARY_PATH"] == "/opt/ros/jazzy/lib"
    monkeypatch.setenv("LD_LIBRARY_PATH", libraries[0])
    assert "LD_LIBRARY_PATH" not in bootstrap.clean_environment()


def test_libraries_of_an_installed_ros_are_handed_on(bootstrap: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(bootstrap.WHEELS_MARK, raising=False)
    monkeypatch.setenv("LD_LIBRARY_PATH", "/opt/ros/jazzy/lib:/opt/other/lib")
    assert bootstrap.clean_environment()["LD_LIBRARY_PATH"] == "/opt/ros/jazzy/lib:/opt/other/lib"


class Steps:
    """Stands in for what takes minutes, and notes it."""

    def __init__(self, bootstrap: ModuleType, monkeypatch: pytest.MonkeyPatch, root: Path, ros: str) -> None:
        self.done: list[object] = []
        self.ros = ros
        monkeypatch.setattr(bootstrap, "ROOT", root)
        monkeypatch.setattr(bootstrap, "create", self.create)
        monkeypatch.setattr(bootstrap, "install", lambda python, extras: self.done.append(extras))

    def create(self, environment: Path, base: Path) -> str:
        (environment / "bin").mkdir(parents=True, exist_ok=True)
        (environment / "bin" / "python").touch()
        self.done.append("create")
        return self.ros

    def take(self) -> list[object]:
        done, self.done = self.done, []
        return done


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    (tmp_path / "src").mkdir()
    (tmp_path / "src" / "module.py").write_text("x = 1\n")
    return tmp_path


def test_only_what_has_changed_is_done_again(
    bootstrap: ModuleType, monkeypatch: pytest.MonkeyPatch, checkout: Path
) -> None:
    steps = Steps(bootstrap, monkeypatch, checkout, "wheels")
    environment = checkout / ".venv"
    bootstrap.prepare(environment, {"ros"})
    assert steps.take() == ["create", ["ros"]]
    bootstrap.prepare(environment, {"ros"})
    assert steps.take() == []
    bootstrap.prepare(environment, {"ros", "test"})
    assert steps.take() == [["ros", "test"]]
    bootstrap.prepare(environment, {"ros"})
    assert steps.take() == []
    (checkout / "src" / "module.py").write_text("x = 2\n")
    bootstrap.prepare(environment, {"ros"})
    assert steps.take() == [["ros", "test"]]
    monkeypatch.setattr(sys, "version", "another Python")
    bootstrap.prepare(environment, {"ros"})
    assert steps.take() == ["create", ["ros"]]


def test_an_installation_that_failed_is_done_again(
    bootstrap: ModuleType, monkeypatch: pytest.MonkeyPatch, checkout: Path
) -> None:
    steps = Steps(bootstrap, monkeypatch, checkout, "wheels")

    def fail(python: Path, extras: list[str]) -> None:
        raise bootstrap.BootstrapError("no network")

    with monkeypatch.context() as patch:
        patch.setattr(bootstrap, "install", fail)
        with pytest.raises(bootstrap.BootstrapError):
            bootstrap.prepare(checkout / ".venv", {"ros"})
    steps.take()
    bootstrap.prepare(checkout / ".venv", {"ros"})
    assert steps.take() == ["create", ["ros"]]


def test_wheels_of_ros_are_left_out_where_ros_is_installed(
    bootstrap: ModuleType, monkeypatch: pytest.MonkeyPatch, checkout: Path
) -> None:
    steps = Steps(bootstrap, monkeypatch, checkout, "system")
    bootstrap.prepare(checkout / ".venv", {"ros", "test"})
    assert steps.take() == ["create", ["test"]]
    bootstrap.prepare(checkout / ".venv", {"ros", "test"})
    assert steps.take() == []


def test_builds_leave_no_trace_in_the_fingerprint(
    bootstrap: ModuleType, monkeypatch: pytest.MonkeyPatch, checkout: Path
) -> None:
    monkeypatch.setattr(bootstrap, "ROOT", checkout)
    before = bootstrap.digest()
    (checkout / "src" / "__pycache__").mkdir()
    (checkout / "src" / "__pycache__" / "module.pyc").write_bytes(b"x")
    (checkout / "src" / "x.egg-info").mkdir()
    (checkout / "src" / "x.egg-info" / "PKG-INFO").touch()
    assert bootstrap.digest() == before
    (checkout / "src" / "module.py").chmod(0o755)
    assert bootstrap.digest() != before


def test_what_is_hardly_imported_is_not_compiled(bootstrap: ModuleType, tmp_path: Path) -> None:
    """Also where the checkout itself lies among tests, and where a library has a file that no Python reads."""
    folder = tmp_path / "tests" / "site-packages"
    texts = {"lib/used.py": "x = 1", "lib/tests/test_used.py": "x = 1", "lib/broken.py": "x = =", "pip/run.py": "x = 1"}
    for name, text in texts.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    bootstrap.compile_all(sys.executable, str(folder))
    assert [path.name.split(".")[0] for path in folder.rglob("*.pyc")] == ["used"]


def test_uv_is_told_what_pip_is_configured_to_do(
    bootstrap: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Or is not asked, where it has no word for it."""
    settings = tmp_path / "pip.conf"
    monkeypatch.setenv("PIP_CONFIG_FILE", str(settings))
    for name in [name for name in os.environ if name.startswith("PIP_") and name != "PIP_CONFIG_FILE"]:
        monkeypatch.delenv(name)
    settings.write_text(
        "[global]\nindex-url = https://here.example/simple\nfind-links =\n  /wheels\n  /more\ntimeout = 9\n"
    )
    options = bootstrap.uv_options(sys.executable)
    pairs = set(zip(options[::2], options[1::2], strict=True))
    assert {("--default-index", "https://here.example/simple"), ("--find-links", "/more")} < pairs
    settings.write_text("[global]\nno-index = true\n")
    assert bootstrap.uv_options(sys.executable) is None
    assert not bootstrap.installed_by_uv(sys.executable, "nothing", beside_ros=False)


def test_beside_a_ros_that_is_installed_pip_installs(bootstrap: ModuleType) -> None:
    assert not bootstrap.installed_by_uv(sys.executable, "nothing", beside_ros=True)
