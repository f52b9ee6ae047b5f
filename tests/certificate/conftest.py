# SPDX-License-Identifier: Apache-2.0
"""A measurement with all that a certificate of it needs, and the certificate of it in each form."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import pytest

from machine_tool_calibration.budget.contributor import template_of
from machine_tool_calibration.certificate.pages import write_certificate
from machine_tool_calibration.certificate.particulars import Certificate, DecisionRule, read_certificate
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.report.evaluation import Evaluation, evaluate
from machine_tool_calibration.reports.identification import Measured
from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate
from machine_tool_calibration.words import words

FILES = Path(__file__).parents[2] / "config" / "certificates"
LABORATORY, ORDER = FILES / "laboratory.yaml", FILES / "order.yaml"


def session_of(kind: str, instrument: str = "") -> Session:
    """A simulated measurement; of an instrument with its budget."""
    session = simulate(SimulationSpec(plan=PRESETS[kind], seed=4)).session
    lines = template_of(instrument) if instrument else ()
    return replace(session, description=session.description.model_copy(update={"budget": lines}))


@cache
def evaluated(kind: str, instrument: str = "", tolerance: float = 0.0) -> Evaluation:
    """What a certificate of it tells."""
    session = session_of(kind, instrument)
    limits = {"A": tolerance} if tolerance else None
    return evaluate(Measured((session,), FitRequest((session,))), diagnosis=False, tolerances=limits)


@cache
def complete() -> Evaluation:
    """Of a run by ISO 230-2 with a budget and a tolerance."""
    return evaluated("iso230_2", "laser_interferometer", 25e-6)


def stated() -> Certificate:
    """What the files of the example state."""
    return read_certificate([LABORATORY, ORDER], complete().measured.recorded)


@dataclass(frozen=True)
class Made:
    """Where a certificate and its session are."""

    session: Path
    folder: Path

    def __getitem__(self, ending: str) -> Path:
        return self.folder / f"certificate.{ending}"


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """The certificate as PDF, page and DCC."""
    assert stated().decision_rule == DecisionRule(agreed="order K-118, 2026-01-10")
    out = Made(tmp_path_factory.mktemp("session") / "run", tmp_path_factory.mktemp("certificate"))
    write_session(session_of("iso230_2", "laser_interferometer"), out.session)
    write_certificate(complete(), stated(), words("en"), [out["pdf"], out["html"], out["xml"]])
    return out
