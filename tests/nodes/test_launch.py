"""Launch files, as far as they can be looked at where `launch` is not installed."""

import ast
from pathlib import Path

import pytest

from machine_tool_calibration.nodes.measurement import NODES

LAUNCH = Path(__file__).parents[2] / "launch"


@pytest.mark.parametrize("file", sorted(LAUNCH.glob("*.launch.py")), ids=lambda file: file.name)
def test_launch_files_compile_and_describe_a_launch(file):
    tree = ast.parse(file.read_text(), str(file))
    compile(tree, str(file), "exec")
    assert "generate_launch_description" in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert ast.get_docstring(tree).count("ros2 launch machine_tool_calibration")
    # what they import of this package is there
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and node.module.startswith("machine_tool_calibration"):
            module = __import__(node.module, fromlist=[alias.name for alias in node.names])
            assert all(hasattr(module, alias.name) for alias in node.names)


def test_every_node_has_an_executable():
    scripts = {file.name for file in (LAUNCH.parent / "scripts" / "nodes").iterdir()}
    assert set(NODES) <= scripts
