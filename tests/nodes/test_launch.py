# SPDX-License-Identifier: Apache-2.0
"""Launch files, as far as they can be looked at where `launch` is not installed."""

import ast
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.simulation.site import read_site

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


# --- what they do, with records in place of `launch`


class Record:
    """Of an action: its kind and what it was made with."""

    def __init__(self, *arguments, **named):
        self.arguments, self.named = arguments, named


KINDS = ("LaunchDescription", "DeclareLaunchArgument", "LogInfo", "OpaqueFunction", "Shutdown", "LifecycleNode")


@pytest.fixture
def launch(monkeypatch, tmp_path):
    """Loads a launch file."""
    (tmp_path / "log").mkdir()
    made = {kind: type(kind, (Record,), {}) for kind in KINDS}

    def configuration(name):
        return SimpleNamespace(perform=lambda context: context.launch_configurations[name])

    contents = {
        "launch": {"LaunchDescription": made["LaunchDescription"]},
        "launch.actions": made,
        "launch.logging": {"launch_config": SimpleNamespace(log_dir=str(tmp_path / "log"))},
        "launch.substitutions": {"LaunchConfiguration": configuration},
        "launch_ros": {},
        "launch_ros.actions": made,
        "ament_index_python": {},
        "ament_index_python.packages": {"get_package_share_directory": lambda name: str(LAUNCH.parent)},
    }
    for name, content in contents.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)

    def load(file):
        return runpy.run_path(str(LAUNCH / file))

    return load


def started(found, **given):
    usual = {name: default for name, (default, _) in found["ARGUMENTS"].items()}
    return found["nodes"](SimpleNamespace(launch_configurations={**usual, **given}))


def nodes(found, **given):
    """The node actions among what is started."""
    return [action for action in started(found, **given) if type(action).__name__ == "LifecycleNode"]


def test_what_is_simulated_stays_with_the_logs_of_the_launch(launch, monkeypatch, tmp_path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(elsewhere))
    (node,) = [node for node in nodes(launch("graph.launch.py")) if node.named["name"] == "instrument"]
    file, parameters = node.named["parameters"]
    assert file == str(LAUNCH.parent / "config" / "nodes.yaml")
    assert parameters["site"] == str(tmp_path / "log" / "site.yaml")
    assert read_site(parameters["site"]).machine.chain == "w-C-b-Y-X-Z-t"
    assert not list(elsewhere.iterdir())


def test_switches_take_what_people_write_and_nothing_else(launch):
    found = launch("graph.launch.py")
    for record, count in (("1", 1), ("True", 1), ("on", 1), ("0", 0), ("no", 0)):
        made = nodes(found, record=record, use_sim_time="1")
        assert sum(node.named["name"] == "recorder" for node in made) == count
        assert all(node.named["parameters"][1]["use_sim_time"] is True for node in made)
    with pytest.raises(CalibrationError, match="record:=maybe is neither true nor false"):
        started(found, record="maybe")
    with pytest.raises(CalibrationError, match="use_sim_time:= is neither"):
        started(launch("identify.launch.py"), use_sim_time="")


def test_an_argument_that_there_is_not_is_refused(launch, monkeypatch):
    found = launch("graph.launch.py")
    assert nodes(found, of_the_file_that_includes_it="1")
    monkeypatch.setattr("sys.argv", ["ros2", "launch", "machine_tool_calibration", "graph.launch.py", "recrod:=1"])
    with pytest.raises(CalibrationError, match=r"^there is no argument 'recrod' \(did you mean 'record'\?\)"):
        started(found, recrod="1")


def test_a_file_of_parameters_that_is_not_there_is_refused(launch):
    for file in ("identify.launch.py", "graph.launch.py"):
        with pytest.raises(CalibrationError, match=r"^params_file: none\.yaml: no such file$"):
            started(launch(file), params_file="none.yaml")


def test_a_driver_that_is_not_there_or_lives_in_simulated_time_is_refused(launch):
    with pytest.raises(CalibrationError, match=r"^driver: none\.yaml: no such file$"):
        started(launch("graph.launch.py"), driver="none.yaml", use_sim_time="false")
    with pytest.raises(CalibrationError, match=r"^driver: a real driver needs real time"):
        started(launch("graph.launch.py"), driver=__file__)


def test_a_recording_that_cannot_be_made_is_refused_before_anything_is_measured(launch, tmp_path):
    (tmp_path / "file").touch()
    for file in ("identify.launch.py", "graph.launch.py"):
        with pytest.raises(CalibrationError, match=r"file: cannot be made: "):
            started(launch(file), bag=str(tmp_path / "file"))
        with pytest.raises(CalibrationError, match=r"is not empty; a recording needs a new folder$"):
            started(launch(file), bag=str(tmp_path))
        assert started(launch(file), bag=str(tmp_path / "new"))
    assert started(launch("graph.launch.py"), bag=str(tmp_path), record="false")


def test_who_has_no_axes_and_no_clock_is_told(launch):
    first, *_ = started(launch("graph.launch.py"), axes="false", namespace="cell_1/")
    assert "the nodes wait for a /cell_1/clock of yours" in first.named["msg"]
    first, *_ = started(launch("graph.launch.py"), axes="false")
    assert first.named["msg"].startswith("axes:=false with use_sim_time:=true: the nodes wait for a /clock of yours")
    made = started(launch("graph.launch.py"), axes="false", use_sim_time="false")
    (procedure,) = [one for one in made if one.named.get("name") == "procedure"]
    assert procedure.named["parameters"][1]["arrival"] == "joint_states"


def test_each_node_goes_to_its_active_state_unless_a_manager_takes_it_there(launch):
    for file in ("identify.launch.py", "graph.launch.py"):
        for given, told in ({}, True), ({"autostart": "false"}, False):
            made = nodes(launch(file), **given)
            assert made and all(node.named["parameters"][1]["autostart"] is told for node in made)


@pytest.mark.parametrize("name", ["instrument", "procedure", "axis_simulator"])
def test_a_launch_ends_with_a_node_that_is_needed(launch, name):
    on_exit = exit_handler(launch("graph.launch.py"), name)
    running = SimpleNamespace(is_shutdown=False)
    # what a handler raises is all that makes the status of `ros2 launch` another than 0
    with pytest.raises(CalibrationError, match=rf"^{name} has ended \(status -9\), and nothing can be measured"):
        on_exit(ended(name, -9), running)
    done = on_exit(ended(name, 0), running)
    assert type(done).__name__ == "Shutdown" and f"{name} has ended (status 0)" in done.named["reason"]
    assert on_exit(ended(name, -9), SimpleNamespace(is_shutdown=True)) is None


@pytest.mark.parametrize(
    ("file", "name"),
    [("graph.launch.py", "estimator"), ("graph.launch.py", "recorder"), ("identify.launch.py", "recorder")],
)
def test_a_node_that_only_listens_is_started_again_where_it_fails(launch, file, name, tmp_path):
    running, count, bag = SimpleNamespace(is_shutdown=False), 1, str(tmp_path / "run")
    on_exit = exit_handler(launch(file), name, bag=bag)
    assert on_exit(ended(name, 1), SimpleNamespace(is_shutdown=True)) is None
    for status in (0, 1):  # it has ended by itself, or could not start, as it could not a second time
        alone = on_exit(ended(name, status), running)
        assert type(alone).__name__ == "LogInfo" and alone.named["msg"].endswith("the other nodes go on without it")
    while not isinstance(done := on_exit(ended(name, -9), running), Record):
        said, again = done
        count += 1
        assert f"{name} has ended (status -9)" in said.named["msg"] and "started again" in said.named["msg"]
        assert again.named["name"] == name
        assert again.named["parameters"][1].get("folder") == (f"{bag}_{count}" if name == "recorder" else None)
        on_exit = again.named["on_exit"]
    assert count == 4 and done.named["msg"].endswith("go on without it")


def exit_handler(found, name, **given):
    """What a launch file does when the node of that name ends."""
    (node,) = [node for node in nodes(found, **given) if node.named["name"] == name]
    return node.named["on_exit"]


def ended(name, status):
    return SimpleNamespace(action=SimpleNamespace(node_name=f"/cell_1/{name}"), returncode=status)
