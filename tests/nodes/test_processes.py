# SPDX-License-Identifier: Apache-2.0
"""Each node as a process: it stops when asked, refuses what is wrong, and describes its parameters.
`--help` of every executable says what it is and takes, and starts nothing.
"""

import os
import re
import select
import signal
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
import yaml
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters
from rclpy.parameter import parameter_value_to_python

from machine_tool_calibration.nodes.__main__ import main
from machine_tool_calibration.nodes.graph import Graph, _interrupted_later
from machine_tool_calibration.nodes.ros.process import SAVE_GRACE, STOP_GRACE

from .conftest import PATIENCE, ask, begin
from .forked import Forked

CONFIG = Path(__file__).parents[2] / "config"

NAMES = ("axis_simulator", "rotary_pointer", "instrument", "procedure", "estimator")


@pytest.fixture
def interruptible():
    """Ctrl-C ends a program as Python has it, whatever a test before this one left."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_ctrl_c_while_a_process_is_started_comes_when_it_is(interruptible):
    done = []
    with pytest.raises(KeyboardInterrupt), _interrupted_later():
        signal.raise_signal(signal.SIGINT)
        done.append("started")
    assert done == ["started"] and signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_stops_in_the_middle_of_work(bench, number):
    more = {"procedure": {"patience": None}}  # whose default is looked at
    graph = bench.graph(NAMES, simulated_time=number == signal.SIGINT, more=more)
    operator = bench.operator(graph)
    if number == signal.SIGTERM:  # before the work, on the same graph
        check_descriptions(operator)
        check_examples(operator)
    begin(operator)
    # all of them at work, the estimator too, which takes longest to start
    assert operator.wait(
        lambda: len(operator.heard.session()[1]) >= 2 and operator.heard.said("estimator").number("readings") > 0,
        PATIENCE,
    )
    for name in ("estimator", "instrument", "rotary_pointer", "axis_simulator", "procedure"):
        assert graph.ends(name, number), (graph.folder / f"{name}.log").read_text()


def test_what_does_not_end_by_itself_is_ended_by_force():
    assert STOP_GRACE < 2.0 < SAVE_GRACE
    code = (
        "import threading; from machine_tool_calibration.nodes.ros import process;"
        "process._made = lambda create, args: (print('held', flush=True), threading.Event().wait());"
        "process.run(object, ['estimator'], grace=0.1)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as node:
        assert node.stdout.readline() == "held\n"
        node.send_signal(signal.SIGTERM)
        _, said = node.communicate(timeout=PATIENCE)
    assert node.returncode == 1
    assert said.endswith("not ended 0.1 s after the signal: ended by force\n")
    assert "in wait" in said, "the trace shows what held it"


def test_the_graph_ends_with_its_starter(tmp_path, ros_domain):
    code = (
        "import os, sys, time; from pathlib import Path;"
        "from machine_tool_calibration.nodes.graph import Graph;"
        f"g = Graph({{'rotary_pointer': {{}}}}, Path({str(tmp_path)!r}), {ros_domain}); g.__enter__();"
        "print(g.process_id('rotary_pointer'), flush=True); time.sleep(900)"
    )
    starter = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    child = os.pidfd_open(int(starter.stdout.readline()))
    starter.kill()
    starter.wait()
    assert select.select([child], [], [], PATIENCE)[0], "it lives on"
    os.close(child)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_stopped_while_it_is_still_importing_it_ends_quietly(number):
    code = (
        "import time; from machine_tool_calibration.nodes import __main__ as program;"
        f"program.import_module = lambda _: (print('importing', flush=True), time.sleep({PATIENCE}));"
        "program.main('axis_simulator', [])"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # a shell has its background jobs ignore Ctrl-C, and they pass that on
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as process:
        assert process.stdout.readline() == "importing\n"
        process.send_signal(number)
        assert process.communicate(timeout=PATIENCE) == ("", "")
        assert process.returncode == 0


def test_other_programs_keep_their_signals():
    code = "import signal; n = signal.SIGINT; h = signal.getsignal(n); import machine_tool_calibration.nodes;"
    code += "import machine_tool_calibration.nodes.ros.process; assert signal.getsignal(n) is h"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=PATIENCE)


WRONG = [
    ("procedure", {}, "the parameter procedure must name a procedure's YAML file"),
    ("axis_simulator", {"site": "/nowhere.yaml"}, "/nowhere.yaml: no such file"),
    ("axis_simulator", {"publish_clock": True}, "parameter publish_clock needs use_sim_time: true"),
    ("axis_simulator", {"speed": -1.0}, "speed"),
    ("instrument", {"driver": "/nowhere.yaml"}, "/nowhere.yaml: no such file"),
    ("estimator", {"model": ""}, "Couldn't parse parameter override rule: '-p model:='"),
]


@pytest.mark.long
def test_what_is_wrong_is_said_in_one_line(tmp_path):
    started = []
    for number, (name, parameters, message) in enumerate(WRONG):
        command = [sys.executable, "-m", "machine_tool_calibration.nodes", name, "--ros-args"]
        for key, value in parameters.items():
            command += ["-p", f"{key}:={str(value).lower() if isinstance(value, bool) else value}"]
        log = tmp_path / f"{number}.log"
        if number:
            process = Forked(command, dict(os.environ), log)
        else:  # one that says what its imports may say, too
            with log.open("w") as file:
                process = subprocess.Popen(command, stderr=file)
        started.append((process, log, name, message))
    for process, log, name, message in started:
        assert process.wait(PATIENCE) == 1
        said = log.read_text()
        assert len(said.splitlines()) == 1, said
        assert said.startswith(f"{name}: ") and message in said


def check_descriptions(operator):
    for name in NAMES:
        listed = ask(operator, ListParameters, f"{name}/list_parameters", ListParameters.Request())
        own = [key for key in listed.result.names if key not in ("use_sim_time", "start_type_description_service")]
        assert own
        request = DescribeParameters.Request(names=own)
        for descriptor in ask(operator, DescribeParameters, f"{name}/describe_parameters", request).descriptors:
            assert len(descriptor.description) > 15, (name, descriptor.name)
            if descriptor.type == ParameterType.PARAMETER_DOUBLE:
                assert descriptor.floating_point_range, (name, descriptor.name)
                assert descriptor.description.endswith("]"), f"{name}: {descriptor.name} has no unit"
            if descriptor.type == ParameterType.PARAMETER_INTEGER:
                assert descriptor.integer_range, (name, descriptor.name)


def check_examples(operator):
    given = yaml.safe_load((CONFIG / "nodes.yaml").read_text())
    assert sorted(key.rsplit("/", 1)[1] for key in given) == sorted(NAMES)
    for name in NAMES:
        wanted = given[f"/**/{name}"]["ros__parameters"]
        if name == "instrument":
            del wanted["sample_noise"]  # the bench sets it
        request = GetParameters.Request(names=list(wanted))
        found = ask(operator, GetParameters, f"{name}/get_parameters", request).values
        assert {key: parameter_value_to_python(value) for key, value in zip(wanted, found, strict=True)} == wanted


@pytest.mark.long
def test_parameter_files_reach_the_nodes_in_a_namespace(bench):
    text = (CONFIG / "nodes.yaml").read_text()
    assert "    speed: 0.5 " in text
    (bench.folder / "nodes.yaml").write_text(text.replace("    speed: 0.5 ", "    speed: 0.123 "))
    nodes = {"axis_simulator": {"use_sim_time": True}}
    graphs = [
        bench.stack.enter_context(
            Graph(nodes, bench.folder / f"log-{namespace}", bench.domain, namespace, bench.folder / "nodes.yaml")
        )
        for namespace in ("", "cell_3")
    ]
    for graph in graphs:
        operator = bench.operator(graph)
        request = GetParameters.Request(names=["speed", "acceleration"])
        values = ask(operator, GetParameters, "axis_simulator/get_parameters", request).values
        assert [value.double_value for value in values] == [0.123, 2.0]


ROOT = Path(__file__).parents[2]
EXECUTABLES = sorted(path.name for path in (ROOT / "scripts" / "nodes").iterdir())


@pytest.mark.parametrize("name", EXECUTABLES)
@pytest.mark.parametrize("given", [["--help"], ["-h", "--ros-args", "-p", "rate:=1.0"]])
def test_help_says_what_it_is_and_takes_and_starts_nothing(name, given, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("rclpy.init", lambda *_, **__: pytest.fail("it was started"))
    module = import_module(f"machine_tool_calibration.nodes.{name}")
    monkeypatch.setattr("signal.signal", lambda *_: None)
    assert main(name, given) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"Usage: ros2 run machine_tool_calibration {name} ")
    assert module.__doc__.strip() in said
    declared = yaml.safe_load(Path(module.__file__).with_name("parameters.yaml").read_text())[name]
    assert declared
    assert all(re.search(rf"^\| .*`{key}`", said, re.M) for key in [*declared, "use_sim_time"])
    assert Path(said.strip().rpartition(": ")[2]).is_file()
    assert not list(tmp_path.iterdir())


def test_help_into_a_pipe_that_nobody_reads_any_more(monkeypatch):
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as stream:
        monkeypatch.setattr("sys.stdout", stream)
        monkeypatch.setattr("signal.signal", lambda *_: None)
        assert main("estimator", ["--help"]) == 0
