# SPDX-License-Identifier: Apache-2.0
"""What an installation consists of, and that what it needs is declared.
A workspace build, where colcon is installed.
"""

import ast
import configparser
import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
import zipfile
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest

from machine_tool_calibration import __version__
from machine_tool_calibration.nodes.__main__ import NODES as RUN
from machine_tool_calibration.nodes.measurement import NODES

PACKAGE = "machine_tool_calibration"
ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / PACKAGE
EXECUTABLES = sorted(path.name for path in (ROOT / "scripts" / "nodes").iterdir())
DATA = f"{PACKAGE}-{__version__}.data/data"
# Rooms whose libraries are an extra of that name, and the modules that they alone import.
EXTRAS = {"workbench": re.compile(r"bokeh|panel|tornado"), "fleet": re.compile(r"dask|distributed")}
# ROS packages: exec_depend of package.xml, the extra `ros` of setup.cfg.
ROS = re.compile(r"rclpy|ament_index_python|launch|launch_ros|std_srvs|[a-z]+_(msgs|interfaces)")
# Name of the distribution in package.xml, where it is not python3-<name>; None where rosdep has no key for it.
ROSDEP = {"mcap": "mcap-ros2-support", "zstandard": "mcap-ros2-support", "lz4": "mcap-ros2-support",
          "pint": None, "plotly": None, "weasyprint": "python3-weasyprint-pip", "threadpoolctl": None,
          "pyarrow": None, "pillow": "python3-pil", "pyserial": "python3-serial",
          "pyyaml": "python3-yaml", "rosbags": "python3-rosbags-pip"}  # fmt: skip
# Keys that rosdep knows: rosdep/python.yaml of ros/rosdistro, and packages of its jazzy/distribution.yaml.
# Look there before a line is added.
KNOWN_KEYS = {
    *(f"python3-{name}" for name in (
        "click", "ezdxf", "hypothesis", "jinja2", "matplotlib", "numpy", "pandas", "pil", "pydantic",
        "pytest", "pytest-timeout", "pytest-xdist", "rich", "rosbags-pip", "scipy", "serial", "weasyprint-pip",
        "yaml")),
    "mcap-ros2-support",
    "action_msgs", "ament_flake8", "ament_index_python", "ament_pep257", "builtin_interfaces", "diagnostic_msgs",
    "geometry_msgs", "launch", "launch_ros", "lifecycle_msgs", "rcl_interfaces", "rclpy", "ros2launch", "rosgraph_msgs",
    "sensor_msgs", "std_msgs", "std_srvs", "trajectory_msgs", "visualization_msgs",
}  # fmt: skip


def imported(path: Path) -> set[str]:
    """First names of the modules that a file imports when it is imported or run."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module.split(".")[0])
    return names - set(sys.stdlib_module_names) - {PACKAGE}


@cache
def all_imported() -> dict[str, list[Path]]:
    """By module, the files that import it."""
    paths = [*SOURCE.rglob("*.py"), *(ROOT / "launch").glob("*.py")]
    found: dict[str, list[Path]] = {}
    for path in sorted(paths):
        for name in imported(path):
            found.setdefault(name, []).append(path)
    return found


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def required(extra: str = "") -> set[str]:
    config = configparser.ConfigParser()
    config.read(ROOT / "setup.cfg")
    lines = (config["options.extras_require"][extra] if extra else config["options"]["install_requires"]).split("\n")
    return {normal(re.split(r"[<>=!~ ;\[]", line)[0]) for line in lines if line}


def described() -> ET.Element:
    return ET.parse(ROOT / "package.xml").getroot()


def depends() -> set[str]:
    return {element.text or "" for element in described() if element.tag in ("depend", "exec_depend")}


@cache
def provided(name: str) -> set[str]:
    """Modules that a distribution brings; its own name where it is not installed."""
    try:
        files = distribution(name).files or []
    except PackageNotFoundError:
        return {name}
    return {file.parts[0].removesuffix(".py") for file in files}


def test_every_imported_distribution_is_required() -> None:
    for module, paths in all_imported().items():
        if not ROS.fullmatch(module):
            extra = next((room for room, own in EXTRAS.items() if own.fullmatch(module)), "")
            place = f"the extra {extra}" if extra else "install_requires"
            brought = set().union(*map(provided, required(extra)))
            assert module in brought, f"{paths[0]} imports {module}: add it to {place} in setup.cfg"


@pytest.mark.parametrize("room", EXTRAS)
def test_only_its_room_imports_what_an_extra_brings(room: str) -> None:
    importing = {path for name, paths in all_imported().items() if EXTRAS[room].fullmatch(name) for path in paths}
    assert importing and not [path for path in importing if SOURCE / room not in path.parents]


def test_every_ros_package_is_named_in_package_xml() -> None:
    for module, paths in all_imported().items():
        if ROS.fullmatch(module):
            assert module in depends(), f"{paths[0]} imports {module}: add it to package.xml"


def test_rosdep_names_every_requirement() -> None:
    for name in required():
        key = ROSDEP.get(name, f"python3-{name}")
        assert key is None or key in depends(), f"{name} of setup.cfg is missing in package.xml"


def test_rosdep_knows_every_key() -> None:
    named = {element.text for element in described() if element.tag.endswith("depend")}
    assert named <= KNOWN_KEYS, f"{sorted(named - KNOWN_KEYS)}: not among the keys that were found in rosdistro"


def test_package_xml_says_what_a_release_asks_for() -> None:
    """REP 149: a maintainer with an address, a licence; none that is invented; `ros2 launch` for the launch files."""
    maintainer = described().find("maintainer")
    assert maintainer is not None and "@" in maintainer.get("email", "")
    for file in ("package.xml", "setup.cfg"):
        assert "example" not in (ROOT / file).read_text(encoding="utf-8")
    assert described().findtext("license") == "Apache-2.0"
    assert {"launch", "launch_ros", "ros2launch"} <= depends()


def test_optional_requirements_are_not_needed_to_import_the_command() -> None:
    assert not {module for module in imported(SOURCE / "cli" / "main.py")} - {"click"}


def test_one_version() -> None:
    assert described().findtext("version") == __version__
    assert described().findtext("name") == PACKAGE
    assert described().findtext("export/build_type") == "ament_python"


def test_wheel_has_what_ros_looks_for(wheel: zipfile.ZipFile) -> None:
    names = set(wheel.namelist())
    assert f"{DATA}/share/ament_index/resource_index/packages/{PACKAGE}" in names
    assert f"{DATA}/share/{PACKAGE}/package.xml" in names
    for folder in ("launch", "config", "examples", "msg_docs"):
        for path in (ROOT / folder).rglob("*"):
            if path.is_file() and "__pycache__" not in path.parts:
                assert f"{DATA}/share/{PACKAGE}/{path.relative_to(ROOT)}" in names


def test_source_archive_has_every_folder() -> None:
    grafted = set(re.findall(r"^graft (\S+)", (ROOT / "MANIFEST.in").read_text(encoding="utf-8"), re.MULTILINE))
    made = {"src", "build", "dist", "install", "log", "mtcal_output"}  # src comes by itself, the others from building
    folders = {path.name for path in ROOT.iterdir() if path.is_dir() and not path.name.startswith(".")}
    assert folders - made <= grafted
    assert {folder for folder in grafted if not (ROOT / folder).is_dir()} <= {".ci"}


def test_wheel_has_the_whole_package(wheel: zipfile.ZipFile) -> None:
    names = set(wheel.namelist())
    for path in SOURCE.rglob("*"):
        if path.is_file() and path.suffix in (".py", ".typed", ".yaml", ".json", ".html", ".css"):
            assert str(path.relative_to(SOURCE.parent)) in names
    assert not [name for name in names if name.startswith(("tests/", "scripts/"))]


def test_wheel_has_executables_for_ros2_run(wheel: zipfile.ZipFile) -> None:
    for name in EXECUTABLES:
        entry = wheel.getinfo(f"{DATA}/lib/{PACKAGE}/{name}")
        assert entry.external_attr >> 16 & 0o111 == 0o111, f"{name} cannot be executed"
        assert wheel.read(entry).startswith(b"#!/bin/sh\n")


def test_wheel_has_the_commands(wheel: zipfile.ZipFile) -> None:
    text = wheel.read(f"{PACKAGE}-{__version__}.dist-info/entry_points.txt").decode()
    parser = configparser.ConfigParser()
    parser.read_string(text)
    scripts = dict(parser["console_scripts"])
    assert scripts.pop("mtcal") == f"{PACKAGE}.cli.main:main"
    assert scripts == {f"mtcal-{n.replace('_', '-')}": f"{PACKAGE}.nodes.__main__:console" for n in EXECUTABLES}


def test_every_node_is_an_executable() -> None:
    assert set(RUN) == set(EXECUTABLES), "each node has a link in scripts/nodes, and each link a node"
    assert set(NODES) <= set(RUN)


@pytest.mark.parametrize("name", EXECUTABLES)
def test_an_executable_starts_the_script_of_its_installation(tmp_path: Path, name: str) -> None:
    (tmp_path / "bin").mkdir()
    script = tmp_path / "bin" / f"mtcal-{name.replace('_', '-')}"
    script.write_text('#!/bin/sh\necho "$0" "$@"\n')
    script.chmod(0o755)
    executable = tmp_path / "a folder" / "lib" / PACKAGE / name
    executable.parent.mkdir(parents=True)
    (tmp_path / "a folder" / "bin").symlink_to(tmp_path / "bin")
    executable.symlink_to(ROOT / "scripts" / "nodes" / name)  # as colcon installs with --symlink-install
    done = subprocess.run([executable, "--ros-args", "a b"], capture_output=True, text=True, timeout=900, check=True)
    assert done.stdout.endswith(f"{script.name} --ros-args a b\n")


def test_an_executable_without_a_script_starts_the_module(tmp_path: Path) -> None:
    python = tmp_path / "python3"
    python.write_text('#!/bin/sh\necho "$@"\n')
    python.chmod(0o755)
    done = subprocess.run(
        [ROOT / "scripts" / "nodes" / "rotary_pointer", "-x"],
        capture_output=True, text=True, timeout=900, check=True, env={"PATH": f"{tmp_path}:/usr/bin:/bin"},
    )  # fmt: skip
    assert done.stdout == f"-m {PACKAGE}.nodes rotary_pointer -x\n"


PATH = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)])
COLCON = shutil.which("colcon", path=PATH)


@pytest.mark.long
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
