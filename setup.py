# SPDX-License-Identifier: Apache-2.0
"""Build of the ament_python package: what setup.cfg cannot say.

The executables of `ros2 run` and `ros2 launch` live in lib/<package>/. A wheel ignores `install_scripts`, so small
wrappers get there through `data_files`; they start the console script of the same installation, whose first line names
the right Python.
"""

from pathlib import Path

from setuptools import setup

PACKAGE = "machine_tool_calibration"
HERE = Path(__file__).parent
NODES = sorted(path.name for path in (HERE / "scripts" / "nodes").iterdir())
README = HERE / "README.md"
SHARED_FOLDERS = ("launch", "config", "examples", "msg_docs")


def tree(folder: str) -> list[tuple[str, list[str]]]:
    """Every file below a folder, for share/<package>/<folder>, with its subfolders kept."""
    content: dict[str, list[str]] = {}
    for path in sorted((HERE / folder).rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            name = path.relative_to(HERE)
            content.setdefault(f"share/{PACKAGE}/{name.parent}", []).append(str(name))
    return list(content.items())


setup(
    # Here and not in setup.cfg: colcon cannot read the first, and does not link the README into its build folder.
    python_requires=">=3.11",
    long_description=README.read_text(encoding="utf-8") if README.exists() else "",
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"lib/{PACKAGE}", [f"scripts/nodes/{name}" for name in NODES]),
        *(entry for folder in SHARED_FOLDERS for entry in tree(folder)),
    ],
    entry_points={
        "console_scripts": [
            f"mtcal = {PACKAGE}.cli.main:main",
            *(f"mtcal-{name.replace('_', '-')} = {PACKAGE}.nodes.__main__:console" for name in NODES),
        ],
    },
)
