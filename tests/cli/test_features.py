# SPDX-License-Identifier: Apache-2.0
"""`mtcal features`: table, document, picture, list of points, and what is wrong in one line."""

import json
from pathlib import Path

import numpy as np
import pytest

import machine_tool_calibration as mtcal
from machine_tool_calibration.diagnosis.history import Entry
from machine_tool_calibration.plots.features import draw_features
from machine_tool_calibration.reports.history import fingerprint, history_path, update_history
from machine_tool_calibration.session.folder import read_session

from ..again import measured_again
from ..told import Verb

ROOT = Path(__file__).parents[2]
CROSS = ROOT / "tests" / "data" / "probing_cross"


@pytest.fixture(scope="module")
def listed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two walls of the cross that face each other, and a third one at right angles."""
    walls: dict[str, list[str]] = {}
    for point in read_session(CROSS).description.workpiece:  # type: ignore[attr-defined]
        (x, y), (u, v) = point.position, point.normal
        for name, there in (
            ("upper", x > 0.018 and abs(y - 0.018) < 1e-6 and v < -0.5),
            ("lower", x > 0.018 and abs(y + 0.018) < 1e-6 and v > 0.5),
            ("left", y > 0.018 and abs(x + 0.018) < 1e-6 and u > 0.5),
        ):
            if there:
                walls.setdefault(name, []).append(point.id)
    file = tmp_path_factory.mktemp("features") / "walls.yaml"
    lines = [f"  {name}: [{', '.join(ids)}]" for name, ids in walls.items()]
    file.write_text("\n".join(["format: mtcal-feature-points/1", "features:", *lines]))
    return file


def test_document_table_picture_and_python_say_the_same(verb: Verb, listed: Path, tmp_path: Path) -> None:
    picture = tmp_path / "walls.png"
    asked = ["features", str(CROSS), "--features", str(listed), "--frame", "sphere1,upper"]
    asked += ["--distance", "upper,lower", "--angle", "upper,left", "--draws", "200"]
    document = verb(*asked, "--json", "--plot", picture).document
    assert document["format"] == "mtcal-features/1"
    assert picture.read_bytes().startswith(b"\x89PNG")
    kinds = {entry["name"]: (entry["kind"], entry["points"]) for entry in document["features"]}
    lines, circles = ("upper", "lower", "left"), ("sphere1", "sphere2")
    assert kinds == {**dict.fromkeys(circles, ("circle", 8)), **dict.fromkeys(lines, ("line", 8))}
    quantities = {"-".join(q["features"]) + " " + q["quantity"]: q for q in document["quantities"]}
    apart = quantities["upper-lower distance"]
    assert apart["nominal"] == pytest.approx(0.036)
    assert quantities["upper-left angle"]["nominal"] == pytest.approx(np.pi / 2)
    low, high = apart["draws"]["interval"]
    assert low < apart["deviation"] < high
    assert len(document["covariance"]) == len(document["quantities"]) == 2 * 3 + 3 * 2 + 2

    fit = mtcal.identify(CROSS)
    walls = {name: ids for name, ids in _points(listed).items()}
    found = fit.features(
        named=walls, frame=("sphere1", "upper"), distances=[("upper", "lower")], angles=[("upper", "left")], draws=200
    )
    row = found.table.loc["upper-lower distance"]
    assert (row.deviation, row.u, row.low) == pytest.approx((apart["deviation"], apart["standard_uncertainty"], low))
    assert found.covariance.loc["sphere2 x", "sphere2 x"] == pytest.approx(found.table.loc["sphere2 x", "u"] ** 2)
    assert document["provenance"]["sha256"]
    assert found.document() == document
    assert "sphere1 has no error, upper none in its direction" in repr(found)

    text = verb(*asked).out
    assert text.strip() == found.report().strip()
    assert "0 (datum)" in text and "Not a feature: work: its points lie neither" in text


def _points(file: Path) -> dict[str, list[str]]:
    lines = file.read_text().splitlines()[2:]
    return {line.split(":")[0].strip(): line.split("[")[1].strip("]").split(", ") for line in lines}


def test_centres_and_walls_are_drawn_where_they_are_magnified(listed: Path) -> None:
    found = mtcal.identify(CROSS).features(named=_points(listed))
    (panel,) = draw_features(found).axes
    label = next(text for text in panel.get_legend_handles_labels()[1] if "×" in text)
    scale = float(label.split("×")[1].replace(" ", ""))
    drawn = np.array(
        [line.get_xydata()[0] for line in panel.get_lines() if line.get_marker() == "o" and len(line.get_xydata()) == 1]
    )
    names = [q.name for q in found.quantities]
    for one in found.elements[:2]:
        at = [names.index(f"{one.name} {axis}") for axis in "xy"]
        expected = 1e3 * (one.place + scale * found.deviation[at])
        assert np.min(np.linalg.norm(drawn - expected, axis=1)) < 1e-9


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("features: {a: [1]}", "the key 'format' is missing"),
        ("format: mtcal-feature-points/1", "the key 'features' is missing"),
        ("format: mtcal-feature-points/1\nfeatures: {a: [1, 2]}\nframe: a", "line 3: unknown key 'frame'"),
        ("format: mtcal-feature-points/1\nfeatures:\n  a: 7", "line 3: features.a must be a list, not 7"),
        ("format: mtcal-feature-points/1\nfeatures:\n  a: [x1]", "feature a: the workpiece has no point 'x1'"),
    ],
)
def test_a_wrong_list_is_one_line(verb: Verb, tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "list.yaml"
    file.write_text(text)
    assert message in verb.refused("features", CROSS, "--features", file)


def test_a_line_through_centres_by_their_pattern(verb: Verb) -> None:
    across = verb("features", CROSS, "--through", "across=sphere*", "--json").document["features"][-1]
    assert across == {"name": "across", "kind": "line", "points": 16}


def test_several_sessions_have_no_features(tmp_path: Path) -> None:
    with pytest.raises(mtcal.CalibrationError, match="of one probing session; this fit is of several"):
        mtcal.identify([CROSS, measured_again(CROSS, tmp_path / "again")]).features()


@pytest.mark.long
def test_a_missing_effect_is_said_and_the_model_in_use_has_it(verb: Verb, tmp_path: Path) -> None:
    mtcal.simulate("probing_pins", effects={"probe_pretravel": 3e-6}, seed=2).save(tmp_path / "pins")
    asked = ["features", str(tmp_path / "pins"), "--frame", "pin1,pin11", "--json"]
    out = verb(*asked)
    assert out.err.startswith("warning: The readings scatter")
    plain = _uncertainty(out.out, "pin5")
    session = read_session(tmp_path / "pins")
    better = Entry(
        number=1, made="2026-01-01T00:00:00", by="mtcal improve", model="rigid_body", effects=("probe_pretravel",),
        data=fingerprint(session), used=len(session.readings), rms_residual=1e-6, reduced_chi_square=1.0,
        degrees_of_freedom=500,
    )  # fmt: skip
    update_history(history_path(tmp_path / "pins"), lambda history: history.grown([better]))
    assert "holds a better model" in verb(*asked).err
    out = verb(*asked, "--from-history")
    assert not out.err
    assert _uncertainty(out.out, "pin5") < 0.8 * plain
    verb(*asked, "--from-history", "--effect", "probe_pretravel", status=2)


def _uncertainty(document: str, name: str) -> float:
    """Standard uncertainty of the x of a pin."""
    quantities = json.loads(document)["quantities"]
    (found,) = [q["standard_uncertainty"] for q in quantities if q["features"] == [name] and q["quantity"] == "x"]
    return float(found)
