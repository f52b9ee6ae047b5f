# SPDX-License-Identifier: Apache-2.0
import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from machine_tool_calibration.instruments.drivers.ascii_line import LineParser, LineSplitter
from machine_tool_calibration.instruments.drivers.driver import Sample
from machine_tool_calibration.instruments.drivers.settings import Line, Timeouts, Value

PATTERN = r"(?P<value>\S+)\s+(?P<status>\w+)\s+(?P<beam>[01])"


def parser(**changes: object) -> LineParser:
    line = {"pattern": PATTERN, "beam_ok": ["1"], "status_ok": ["OK"], "ignore": "#.*"} | changes
    return LineParser(Line.model_validate(line), Value(unit="mm", scale=-0.5))


@given(
    lines=st.lists(st.binary(max_size=20).filter(lambda line: b"\r\n" not in line + b"\r"), max_size=8),
    cuts=st.lists(st.integers(0, 200), max_size=8),
)
def test_lines_do_not_depend_on_how_the_bytes_arrive(lines: list[bytes], cuts: list[int]) -> None:
    stream = b"".join(line + b"\r\n" for line in lines)
    whole = list(LineSplitter(b"\r\n", 64, skip_first=False).feed(stream))
    splitter = LineSplitter(b"\r\n", 64, skip_first=False)
    places = sorted({0, *(min(cut, len(stream)) for cut in cuts), len(stream)})
    pieces = [line for a, b in pairwise(places) for line in splitter.feed(stream[a:b])]
    assert pieces == whole == lines


def test_a_stream_joined_in_the_middle_of_a_line_loses_that_line() -> None:
    splitter = LineSplitter(b"\n", 64, skip_first=True)
    assert list(splitter.feed(b"45.678\n")) == []
    assert list(splitter.feed(b"123.456\n123.")) == [b"123.456"]


def test_a_line_without_end_is_handed_out_once_and_dropped() -> None:
    splitter = LineSplitter(b"\r\n", 16, skip_first=False)
    handed = [line for _ in range(50) for line in splitter.feed(b"x" * 10)]
    assert len(handed) == 1
    assert len(handed[0]) > 16
    assert list(splitter.feed(b"\r")) == []
    assert list(splitter.feed(b"\n1.5\r\n")) == [b"1.5"]


def test_value_is_scaled_to_metres() -> None:
    parsed = parser().parse("+12.5 OK 1", 7.0)
    assert parsed == Sample(7.0, -0.5 * 12.5e-3, beam=True, status="OK")


@pytest.mark.parametrize("text", ["nan OK 1", "inf OK 1", "1e999 OK 1", "12.5.1 OK 1", "12.5 OK", "1 OK 1 1", "1 OK 2"])
def test_garbage_is_no_reading(text: str) -> None:
    assert parser().parse(text, 7.0) is None


def test_broken_beam_and_bad_status_have_no_value() -> None:
    assert parser().parse("12.5 OK 0", 7.0) == Sample(7.0, None, beam=False, status="OK")
    assert parser().parse("12.5 OVERSPEED 1", 7.0) == Sample(7.0, None, beam=True, status="OVERSPEED")
    assert parser(beam_broken="BEAM").parse("BEAM", 7.0) == Sample(7.0, None, beam=False, status="")


def test_greetings_and_empty_lines_are_ignored() -> None:
    assert parser().ignored("# LASER V1.2")
    assert parser().ignored("")
    assert not parser().ignored("12.5 OK 1")


@given(st.text(max_size=40))
def test_any_text_is_a_finite_reading_or_none(text: str) -> None:
    parsed = parser(pattern="(?P<value>.*)", beam_ok=[], status_ok=None).parse(text, 7.0)
    assert parsed is None or (parsed.displacement is not None and math.isfinite(parsed.displacement))


def test_times_that_are_not_said_are_such_as_may_be_said() -> None:
    assert Timeouts.model_validate(Timeouts().model_dump()) == Timeouts()
