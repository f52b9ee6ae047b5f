# SPDX-License-Identifier: Apache-2.0
import math
from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.procedure import parse_procedure, plan, read_procedure
from machine_tool_calibration.procedure.description import Spread
from machine_tool_calibration.session.parse import description_yaml, parse_description

from .procedures import TEXT, small

CONFIG = Path(__file__).parents[2] / "config" / "procedures"


def test_runs_every_target_from_every_station_and_back():
    steps = small().steps
    assert len(steps) == 2 * 2 * 6
    assert [step.number for step in steps] == list(range(24))
    assert [(step.setup, step.repeat) for step in steps[::6]] == [("A", 0), ("A", 1), ("B", 0), ("B", 1)]
    first = [(step.position["x"], step.position["y"]) for step in steps[:6]]
    assert first == [(0.0, 0.1), (0.2, 0.1), (0.4, 0.1), (0.0, 0.2), (0.2, 0.2), (0.4, 0.2)]
    assert [(step.position["x"], step.position["y"]) for step in steps[6:12]] == first[::-1]


def test_zeroes_at_the_first_target_of_each_setup():
    assert [step.number for step in small().steps if step.datum] == [0, 12]


def test_directions_are_those_of_the_last_moves():
    steps = small().steps
    # x at the end of its travel is approached from above, y from below
    assert steps[0].via == ({"x": 0.005, "y": 0.1 - 0.005},)
    assert steps[0].direction == {"x": -1, "y": 1}
    assert [step.direction["x"] for step in steps[1:6]] == [1, 1, -1, 1, 1]
    assert steps[6].direction == {"x": 1, "y": 1}  # the same target again: no move
    assert steps[7].direction == {"x": -1, "y": 1}
    assert steps[9].direction == {"x": 1, "y": -1}


def test_serpentine_runs_every_second_line_back():
    steps = small(TEXT.replace("y: [0.1, 0.2]}", "y: [0.1, 0.2]}\n  order: serpentine")).steps
    assert [step.position["x"] for step in steps[:6]] == [0.0, 0.2, 0.4, 0.4, 0.2, 0.0]


def test_without_alternation_every_repetition_runs_alike():
    steps = small(TEXT.replace("y: [0.1, 0.2]}", "y: [0.1, 0.2]}\n  alternate: false")).steps
    assert [step.position for step in steps[6:12]] == [step.position for step in steps[:6]]


def test_ends_of_a_spread_are_exact():
    assert Spread(first=0.1, last=0.7, count=7).values()[::6] == [0.1, 0.7]
    assert Spread(first=0.1, last=0.7, count=1).values() == [0.1]


def test_duration_counts_moves_and_dwells():
    assert small().duration > 24.0


def test_session_is_the_contracts():
    text = description_yaml(small().procedure.session)
    assert parse_description(text, "session.yaml") == small().procedure.session


@pytest.mark.parametrize("file", sorted(CONFIG.glob("*.yaml")), ids=lambda file: file.stem)
def test_procedures_that_the_package_brings_can_be_planned(file):
    made = plan(read_procedure(file))
    session = made.procedure.session
    runs = {(step.setup, step.repeat) for step in made.steps}
    assert runs == {(setup.id, repeat) for setup in session.setups for repeat in range(session.repeats)}
    assert made.procedure.name == file.stem


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("dwell: 1.0", "dwel: 1.0", "small.yaml line 16: unknown key 'motion.dwel'"),
        ("id: B", "id: A", "small.yaml: setups has the id 'A' twice"),
        ("y: [0.1, 0.2]", "y: [0.1, 0.5]", "small.yaml: target 3 is at y = 0.5, outside the travel 0 to 0.4"),
        ("y: [0.1, 0.2]", "a: [0.1, 0.2]", "small.yaml: path names the axis 'a'; the machine has c, x, y, z"),
        ("y: [0.1, 0.2]", "y: []", "small.yaml line 14: path: grid.y has no position"),
        ("count: 3", "count: 1000000", "small.yaml line 14: path: grid has 2000000 targets; at most 1000000"),
        ("{dwell: 1.0}", "{dwell: 1.0e+300}", "small.yaml line 16: motion.dwell"),
        ("{dwell: 1.0}", "{speed: {x: 1.0e-30}}", "small.yaml line 16: motion.speed.x"),
        ("{dwell: 1.0}", "{speed: {q: 1.0}}", "small.yaml: motion.speed names the axis 'q'; the machine has"),
    ],
)
def test_defects_are_named_with_their_place(old, new, message):
    assert old in TEXT
    with pytest.raises(SessionError) as caught:
        small(TEXT.replace(old, new))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def made(name, **changes):
    import yaml

    content = yaml.safe_load((CONFIG / f"{name}.yaml").read_text())
    content["path"] = {**content.get("path", {}), **changes.pop("path", {})} or None
    content["session"] |= changes
    content = {key: value for key, value in content.items() if value is not None}
    return plan(parse_procedure(yaml.safe_dump(content), f"{name}.yaml")).steps


def test_step_diagonal_moves_one_axis_at_a_time_from_the_start_of_each_run():
    steps = made("step_diagonal", blocks=2)
    assert len(steps) == 2 * (4 * 7 + 3 * 3)
    run = steps[:7]
    assert [tuple(step.position[axis] for axis in "xyz") for step in run[:4]] == [
        (0.0, 0.0, 0.0), (0.012, 0.0, 0.0), (0.012, 0.012, 0.0), (0.012, 0.012, 0.012)
    ]  # fmt: skip
    assert [step.datum for step in run] == [True] + [False] * 6
    assert steps[7].repeat == 1 and steps[7].datum
    backwards = [step for step in steps if step.setup == "npp"][:7]
    assert [step.position["x"] for step in backwards] == pytest.approx([0.12, 0.108, 0.108, 0.108, 0.096, 0.096, 0.096])
    assert backwards[1].direction["x"] == -1
    fourth = [step for step in steps if step.setup == "nnp"][:4]
    assert [tuple(step.position[axis] for axis in "xyz") for step in fourth] == [
        pytest.approx(place) for place in ((0.12, 0.12, 0.0), (0.108, 0.12, 0.0), (0.108, 0.108, 0.0),
                                           (0.108, 0.108, 0.012))
    ]  # fmt: skip
    assert not any(step.points for step in steps)


def test_rotary_axis_measures_each_target_at_every_angle_from_one_zero():
    steps = made("rotary_axis_one_way")
    assert len(steps) == 4 * 3 * 18
    assert [step.number for step in steps if step.datum] == list(range(0, 216, 18))
    assert {step.direction["c"] for step in steps} == {1}
    assert steps[18].target == 1 and steps[18].via == ({"c": -0.02},)
    # the beam goes where the target is commanded: turned with the table
    step, angle = steps[1], 5.934119456780721 / 17
    x, y = -0.1058046, 0.1353414
    turned = (x * math.cos(angle) - y * math.sin(angle), x * math.sin(angle) + y * math.cos(angle), 0.0)
    assert step.aim == pytest.approx(turned)
    # and the other way where the session, or else its machine, says that the axis turns so
    back = (x * math.cos(angle) + y * math.sin(angle), -x * math.sin(angle) + y * math.cos(angle), 0.0)
    assert made("rotary_axis_one_way", rotation_sign=-1)[1].aim == pytest.approx(back)
    machine = {"chain": "w-C-b-t", "rotation_sign": -1}
    assert made("rotary_axis_one_way", rotation_sign=None, machine=machine)[1].aim == pytest.approx(back)


def test_turning_points_are_approached_from_both_sides():
    steps = made("rotary_axis")
    assert len(steps) == 2 * 4 * 3 * 18
    assert [step.number for step in steps if step.datum] == list(range(0, 432, 36))
    forth, back = steps[:18], steps[18:36]
    assert [step.position for step in forth] == [step.position for step in back[::-1]]
    assert [step.direction["c"] for step in steps[:36]] == [1] * 18 + [-1] * 18
    assert back[0].via == ({"c": pytest.approx(5.934119456780721 + 0.02)},)


def test_a_repetition_that_begins_at_the_other_end_turns_back_too():
    steps = made("rotary_axis", repeats=2)
    second = [step for step in steps if step.setup == "A" and step.repeat == 1][:36]
    assert second[0].position["c"] == second[-1].position["c"] == pytest.approx(5.934119456780721)
    assert [step.direction["c"] for step in second] == [-1] * 18 + [1] * 18


@pytest.mark.parametrize("key", ["both_ways: true", "targets: at_every_angle"])
def test_only_a_rotary_axis_turns_both_ways_and_has_targets(key):
    name = key.partition(":")[0]
    with pytest.raises(SessionError, match=f"small.yaml: path.{name} is for the method rotary_axis; this is tr"):
        small(TEXT.replace("path:", f"path:\n  {key}"))


def test_all_targets_at_every_angle_as_in_the_paper():
    steps = made("rotary_axis", path={"targets": "at_every_angle", "both_ways": True})
    assert len(steps) == 2 * 4 * 3 * 18
    assert [step.target for step in steps[:7]] == [0, 1, 2, 0, 1, 2, 0]
    assert [step.number for step in steps if step.datum] == list(range(0, 432, 108))
    assert len({step.position["c"] for step in steps[:3]}) == 1 < len({step.position["c"] for step in steps[:4]})
    # The last angle once from each side, for all targets.
    assert [step.direction["c"] for step in steps[:108]] == [1] * 54 + [-1] * 54
    assert [step.number for step in steps[:108] if step.via] == [0, 54]


def test_iso_230_2_goes_forth_and_back_with_an_overrun():
    steps = made("direct_iso230_2")
    assert len(steps) == 5 * 22
    assert [step.direction["x"] for step in steps[:22]] == [1] * 11 + [-1] * 11
    assert steps[0].via == ({"x": pytest.approx(0.00037 - 0.005)},)
    assert steps[11].via == ({"x": pytest.approx(0.40094 + 0.005)},)
    assert steps[22].direction["x"] == 1
    assert [step.number for step in steps if step.datum] == [0]


def test_a_direct_session_must_say_along_which_axis_it_is_read():
    with pytest.raises(SessionError, match="terms must begin with a translation such as EXX"):
        made("direct_iso230_2", terms=["C0Y"])


def test_only_a_step_diagonal_needs_no_path():
    with pytest.raises(SessionError, match=r"small.yaml: the key 'path' is missing"):
        small(TEXT.split("path:")[0])


def test_a_beam_is_held_in_every_direction_at_every_target():
    made = plan(read_procedure(CONFIG / "pointer_centre.yaml"))
    (setup,) = made.procedure.session.setups
    lines = np.array([step.aim for step in made.steps]) - setup.position
    angles = np.degrees(np.arctan2(lines[:, 1], lines[:, 0])) % 360.0
    # Forth in the first repetition, back in the second; the axes stand still, and the path is zeroed once.
    assert np.round(angles, 6) % 360.0 == pytest.approx([*range(0, 360, 10), *range(350, -10, -10)])
    assert {tuple(step.position.values()) for step in made.steps} == {(-0.35, 0.05, 0.0)}
    assert [step.datum for step in made.steps] == [True] + [False] * 71
    assert [step.number for step in made.steps] == list(range(72))
    assert sum(bool(step.via) for step in made.steps) == 1


@pytest.mark.parametrize("name", ["tracking_3d", "rotary_axis"])
def test_a_beam_is_held_by_a_pointer_in_the_plane_alone(name):
    procedure = read_procedure(CONFIG / f"{name}.yaml")
    held = procedure.model_copy(update={"path": procedure.path.model_copy(update={"azimuth": (0.0,)})})
    with pytest.raises(SessionError, match="open-loop pointer in the plane"):
        plan(held)


@pytest.mark.parametrize("ends", [(0.0, 0.4), (0.4, 0.0)])
def test_either_end_is_approached_from_both_sides(ends):
    """A path that descends turns back as one that ascends does: no position loses its reversal."""
    first, last = ends
    text = f"""
format: mtcal-procedure/1
name: there_and_back
session:
  method: direct
  machine: {{chain: w-X-b-t, travel: {{X: [-0.1, 0.6]}}}}
  standard_uncertainty: {{displacement: 1.0e-7}}
  datum: offset
  terms: [EXX]
  setups: [{{id: X}}]
path:
  grid: {{x: {{first: {first}, last: {last}, count: 5}}}}
"""
    steps = plan(parse_procedure(text, "there and back")).steps
    way = 1 if last > first else -1
    assert [step.direction["x"] for step in steps] == [way] * 5 + [-way] * 5
    with pytest.raises(SessionError, match="outside the travel"):
        plan(parse_procedure(text.replace(f"last: {last}", "last: 5.0"), "too far"))


def test_a_point_that_names_no_axis_is_refused():
    text = TEXT.replace("  grid: {x: {first: 0.0, last: 0.4, count: 3}, y: [0.1, 0.2]}", "  points: [{}]")
    with pytest.raises(SessionError, match="points must each name an axis"):
        small(text)
