# SPDX-License-Identifier: Apache-2.0
"""What all tests share: quiet libraries, and a ROS domain that no other test process on this machine uses."""

import atexit
import gc
import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import settings

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.graph import free_domain

from .told import Verb

# The same examples every time, and no limit of the wall clock; HYPOTHESIS_PROFILE=explore looks for many new ones.
settings.register_profile("repeatable", deadline=None, derandomize=True, max_examples=50)
settings.register_profile("explore", deadline=None, print_blob=True, max_examples=500)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))

# Little of what tests make lies in circles: to look for them as often as Python does takes a sixth of their time.
gc.set_threshold(50_000, 20, 100)

# Text is laid out as in a file, whatever the terminal is.
for variable in ("COLUMNS", "LINES"):
    os.environ.pop(variable, None)

# Before anything imports them: pictures without a screen, and one thread for small matrices on a shared machine.
os.environ.setdefault("MPLBACKEND", "Agg")
for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

# When a result was evaluated is part of its document: the same for all, so that documents can be compared.
os.environ.setdefault("SOURCE_DATE_EPOCH", "1767225600")

# Nothing leaves this machine, whatever the user's own setting is.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ.pop("ROS_LOCALHOST_ONLY", None)

_SOCKET_TABLES = (Path("/proc/net/udp"), Path("/proc/net/udp6"))


def _domains_with_nodes() -> set[int]:
    """The domains whose UDP ports are in use on this machine: 250 each from 7400 on (OMG RTPS 2.5, 9.6.2)."""
    lines = [line for table in _SOCKET_TABLES if table.exists() for line in table.read_text().splitlines()[1:]]
    # "  155: 0100007F:6824 00000000:0000 07 …": the second word is the local address and port, in base 16
    return {(int(line.split()[1].rpartition(":")[2], 16) - 7400) // 250 for line in lines}


def _claim_domain() -> Iterator[int]:
    """A domain id that no other program has claimed, and in which none takes part that claims nothing."""
    # Not 0, where a user's own graph may start at any moment; larger ones need ports that the system gives to others.
    for number in range(1, 102):
        with suppress(CalibrationError), free_domain([number]):
            # looked at after the claim: others that have claimed it until now have started their nodes
            if number not in _domains_with_nodes():
                yield number
                return


_claims = _claim_domain()
atexit.register(_claims.close)
os.environ["ROS_DOMAIN_ID"] = str(next(_claims))


# The modules that take longest come first, so that no process is left with one at the end. Those of nodes wait much of
# their time: each stands beside one that calculates.
_FIRST = (
    "packaging/test_lint.py",
    "workbench/test_browser.py",
    "nodes/test_mishaps.py",
    "diagnosis/test_diagnose.py",
    "report/test_report.py",
    "reports/test_document.py",
    "nodes/test_processes.py",
    "packaging/test_documents.py",
    "nodes/test_commands.py",
    "diagnosis/test_direct.py",
    "planning/test_what_to_measure.py",
    "nodes/test_probe.py",
    "controller/test_linuxcnc.py",
    "nodes/test_hostile.py",
    "methods/joint/test_spread.py",
    "nodes/test_whole.py",
    "diagnosis/search/test_engine.py",
    "nodes/test_methods.py",
    "report/test_one_value.py",
    "nodes/test_measurement.py",
    "planning/test_best_plan.py",
    "nodes/test_diagnosis.py",
    "plots/test_diagnosis_pictures.py",
    "nodes/test_instrument.py",
    "cli/test_plan.py",
    "recording/test_recorder.py",
    "planning/test_dominant.py",
    "effects/test_catalogue.py",
    "methods/joint/test_agreement.py",
    "methods/tracking/test_exact.py",
    "nodes/test_player.py",
    "methods/joint/test_split.py",
    "diagnosis/test_compare.py",
    "cli/test_compare.py",
)
# Rooms whose modules look at the same diagnoses or evaluations.
_SHARING = ("certificate", "report", "reports")


def pytest_configure(config: pytest.Config) -> None:
    """What was named is run whole, the long tests too; processes are told."""
    everything = config.args_source is pytest.Config.ArgsSource.TESTPATHS
    if hasattr(config, "workerinput"):
        config.option.long = config.workerinput["long"]
    elif not everything or config.option.keyword or config.option.markexpr:
        config.option.long = True


@pytest.hookimpl(optionalhook=True)  # of pytest-xdist
def pytest_configure_node(node: Any) -> None:
    """Processes do as they are told here."""
    node.workerinput["long"] = node.config.option.long


@pytest.hookimpl(optionalhook=True)  # of pytest-xdist
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """A module's tests run in one process, and so do those of rooms that look at the same: it is calculated once."""
    from xdist.scheduler import LoadScopeScheduling

    class ByWhatIsShared(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            module = nodeid.partition("::")[0]
            room = module.rpartition("/")[0].removeprefix("tests/")
            return room if room in _SHARING else module

    return ByWhatIsShared(config, log) if config.getoption("dist") == "loadscope" else None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """The long modules first, the others in their order; without the long tests where they were not asked for."""
    place = {Path(__file__).parent / name: number for number, name in enumerate(_FIRST)}
    items.sort(key=lambda item: place.get(item.path, len(place)))
    if not config.option.long:
        config.hook.pytest_deselected(items=[item for item in items if _is_long(item)])
        items[:] = [item for item in items if not _is_long(item)]


def _is_long(item: pytest.Item) -> bool:
    """Whether a test takes seconds: by its mark, `long(but=...)` for all but some of its parameters."""
    mark = item.get_closest_marker("long")
    return mark is not None and not any(item.name.endswith(f"[{one}]") for one in mark.kwargs.get("but", ()))


def pytest_collection_finish() -> None:
    """What there is before the first test stays: to look for circles in it, as at the end, takes half a second."""
    gc.freeze()


def pytest_addoption(parser: pytest.Parser) -> None:
    """The statistics of a few simulated measurements are tests; those of hundreds are benchmarks."""
    parser.addoption("--runs", type=int, default=10, help="simulated measurements of a statistical test (default 10)")
    parser.addoption("--long", action="store_true", help="the long tests of all rooms, too")


@dataclass(frozen=True)
class Many:
    """How many simulated measurements a statistical test makes, and how far off its means may be."""

    count: int

    def off(self, of_200: float) -> float:
        """What a mean may be off, from what that of 200 may be."""
        return of_200 * (200 / self.count) ** 0.5

    def part(self, share: float) -> "Many":
        """Fewer or more, for measurements that tell much or little each."""
        return Many(max(2, round(share * self.count)))

    def at_most(self, rate: float) -> float:
        """How often what happens at a rate may happen: with two standard deviations of chance."""
        return self.count * rate + 2.0 * (self.count * rate * (1.0 - rate)) ** 0.5


@pytest.fixture(scope="session")
def many(pytestconfig: pytest.Config) -> Many:
    """As many simulated measurements as the option --runs says."""
    return Many(pytestconfig.getoption("--runs"))


@pytest.fixture
def verb(capsys: pytest.CaptureFixture[str]) -> Verb:
    """Runs a verb of `mtcal` in this process, and says what it printed."""
    return Verb(capsys)


@pytest.fixture(scope="session")
def ros_domain() -> int:
    """The domain id of this test process, which ROS_DOMAIN_ID already holds."""
    return int(os.environ["ROS_DOMAIN_ID"])


@pytest.fixture(scope="module")
def few_draws() -> Iterator[None]:
    """Budgets from a tenth of the random values, for tests of how they are told and not of how well they are known."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("machine_tool_calibration.budget.propagate.DRAWS", 20)
        patch.setattr("machine_tool_calibration.budget.conformity._SAMPLES", 30)
        # where they are used: what the tests of a room need not import they do not
        from machine_tool_calibration.methods.map_comparison import compare_fits
        from machine_tool_calibration.trends.statement import of_fit

        for drawing, draws in ((of_fit, 100), (compare_fits, 160)):  # enough for motions of a few values
            assert drawing.__kwdefaults__ is not None
            patch.setitem(drawing.__kwdefaults__, "draws", draws)
        yield


@pytest.fixture
def reproducible(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is published takes all to reproduce and the model for exact, for what is known in closed form then.

    And noise for independent, of which few readings tell little.
    """
    monkeypatch.setattr("machine_tool_calibration.model.marginal_fit.added_by_memory", lambda *of: np.zeros_like(of[4]))
    monkeypatch.setattr("machine_tool_calibration.model.widening.with_drift", lambda observations: ())
    monkeypatch.setattr("machine_tool_calibration.model.widening.imperfection", lambda observations: np.zeros((0, 1)))
