"""Launch files, as far as they can be looked at where `launch` is not installed."""

import ast
import runpy
import sys
from pathlib import Path
from unittest.mock import MagicMock

import pytest

from machine_tool_calibration.nodes.measurement import NODES
from machine_tool_calibration.nodes.site import read_site

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


@pytest.fixture
def graph_launch(monkeypatch, tmp_path):
    """The launch file of the graph, run with stand-ins for `launch`; gives what `nodes` makes of arguments."""
    parts = ("launch", "launch.actions", "launch.logging", "launch.substitutions", "launch_ros", "launch_ros.actions")
    for name in parts:
        monkeypatch.setitem(sys.modules, name, MagicMock())
    sys.modules["launch.logging"].launch_config.log_dir = str(tmp_path)
    content = runpy.run_path(str(LAUNCH / "graph.launch.py"))

    def run(**arguments):
        given = {name: default for name, (default, _) in content["ARGUMENTS"].items()} | arguments
        configuration = sys.modules["launch.substitutions"].LaunchConfiguration
        configuration.side_effect = lambda name: MagicMock(perform=lambda _: given[name])
        content["nodes"](MagicMock())
        return {call.kwargs["executable"]: call.kwargs for call in sys.modules["launch_ros.actions"].Node.mock_calls}

    return run


def test_what_is_simulated_stays_with_the_logs_of_the_launch(graph_launch, monkeypatch, tmp_path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(elsewhere))
    started = graph_launch(procedure=str(LAUNCH.parent / "config/procedures/tracking_2d.yaml"))
    (parameters,) = started["instrument"]["parameters"]
    assert parameters["site"] == str(tmp_path / "site.yaml")
    assert read_site(parameters["site"]).machine.chain == "w-C-b-Y-X-Z-t"
    assert not list(elsewhere.iterdir())


def test_every_node_has_an_executable():
    scripts = {file.name for file in (LAUNCH.parent / "scripts" / "nodes").iterdir()}
    assert set(NODES) <= scripts
