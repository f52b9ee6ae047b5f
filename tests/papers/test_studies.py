# SPDX-License-Identifier: Apache-2.0
"""The papers' figures that come out the same, and those that cannot.
Papers' figures beside ours: the record, the table, the page.
"""

import numpy as np
import pytest
from papers import study_probing, study_step_diagonal, study_tracking
from papers.page import study_page, study_table, verdict_of
from papers.pictures import draw
from papers.record import Printed, Study


def entry(study: Study, what: str) -> Printed:
    return next(printed for printed in study.printed if printed.what.startswith(what))


def test_a_tilted_mirror_is_behind_table_1_of_the_step_diagonal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study_step_diagonal, "_REPEATS", 1)
    study = study_step_diagonal.study(lambda what, share: None)
    differing = [printed.what for printed in study.printed if not printed.agrees]
    # The printed squareness of Y-Z contradicts the printed positioning errors; the two others do not.
    assert differing == ["squareness of Y-Z, conventional less proposed"]
    assert entry(study, "squareness of X-Y, conventional").ours == pytest.approx(4.4e-6, abs=2e-8)


@pytest.mark.long
def test_the_budget_and_the_map_of_the_open_loop_tracking_interferometer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study_tracking, "DRAWS", 80)
    study = study_tracking.study(lambda what, share: None)
    differing = [printed.what for printed in study.printed if printed.agrees is False]
    assert differing == [
        "u_11 wavelength accuracy",
        "all, root sum of squares of the printed u_1 and u_2",
        "all, sum of the printed u_1 and u_2",
        "by the 2.5e-6/K that the text gives for it",
    ]
    # 0.8 mm beside 320 mm: sqrt(320^2 + 0.8^2) - 320 mm.
    assert entry(study, "cosine error").ours == pytest.approx(0.99999e-6, abs=2e-11)
    assert entry(study, "u_1, root sum of squares").ours == pytest.approx(0.232e-6, abs=1e-9)
    assert entry(study, "all, sum of").ours == pytest.approx(2.63e-6, abs=1e-9)
    assert entry(study, "unknowns in the plane").ours == 2 * 20 + 3 * 3 - 3
    assert entry(study, "largest normalised difference |E_n|, expansion corrected").ours < 1.0


def test_the_datum_of_an_origin_and_an_axis() -> None:
    points = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1]])
    shift, turn = np.array([3e-6, -2e-6]), 1e-5
    moved = shift + turn * np.stack([-points[:, 1], points[:, 0]], axis=1)
    assert np.abs(study_tracking.in_origin_datum(points, moved)).max() < 1e-18
    stretched = moved + 1e-5 * points
    assert study_tracking.in_origin_datum(points, stretched)[2] == pytest.approx([1e-6, 1e-6])


@pytest.fixture(scope="module")
def probing() -> Study:
    return study_probing.study(lambda what, share: None)


def test_what_no_datum_moves_agrees_with_the_paper_on_probing(probing: Study) -> None:
    agreeing = {printed.what for printed in probing.printed if printed.agrees}
    assert agreeing >= {"largest U of X and Y, at Y = ±110 mm", *(f"U of ECC at C = {c}°" for c in (75, 130, 210))}
    share, bare = (entry(probing, what).ours for what in ("share of the grid", "largest U of X and Y without spheres"))
    assert share is not None and share > 0.75
    assert bare is not None and bare > 1.3 * 28e-6


def test_more_angles_and_spheres_lessen_the_uncertainty_of_the_part(probing: Study) -> None:
    for name in ("in the datum", "without shift, turn and growth"):
        two, three, four = (
            printed.ours or 0.0
            for printed in probing.printed
            if printed.what.startswith(f"largest U of the part, {name}")
        )
        assert two > 1.3 * three > 1.3 * four > 1e-6
    more = [printed.ours for printed in probing.printed if printed.where == "Fig. 19"]
    assert len(more) == 2 and all(u is not None and 0.0 < u < 4e-6 for u in more)


def test_the_origin_at_one_node_is_behind_the_centre_of_c(probing: Study) -> None:
    """Another origin shifts the centre of rotation by |1 - R(C)|, whatever the touches are."""
    chord = np.abs(1 - np.exp(1j * np.radians([75, 130, 210])))
    for axis in "XY":
        ours = [p.ours or 0.0 for p in probing.printed if p.what.startswith(f"U of E{axis}C at")]
        per_chord = np.array(ours) / chord
        np.testing.assert_allclose(per_chord, per_chord.mean(), rtol=0.1)


def test_pins_are_found_within_their_uncertainty(probing: Study) -> None:
    raw, found, most = (
        entry(probing, f"largest error of a pin, {what}").ours or 0.0
        for what in ("touches at C", "self-calibrated", "in 95 %")
    )
    assert found < most < 2e-6 < raw


def test_the_pictures_of_the_probing_paper(probing: Study) -> None:
    panels = {name: len(draw(record).axes) for name, record in probing.pictures.items()}
    # A panel and its scale of colours each.
    assert panels == {"part": 8, "form": 8, "axes": 4, "pins": 1}


SAME = Printed("length", "Table 1", 1.17e-6, 1.2e-6, "m", 5e-8)
OTHER = Printed("angle", "Fig. 2", 8.9e-6, 1.2e-5, "rad", 1e-6, "the points are not printed")
SHOWN = Printed("shape", "Fig. 3", None, 2.0, "1", 0.1)
MADE = Study("one", "Somebody: Something. Somewhere (2014)", ("The points are on a circle.",), (SAME, OTHER, SHOWN))


def test_agreement_within_what_is_allowed() -> None:
    assert [entry.agrees for entry in MADE.printed] == [True, False, None]
    assert verdict_of(MADE) == "one: 1 of 2 figures agree"
    assert [row[5] for row in study_table(MADE).rows] == ["yes", "no", ""]


def test_the_page_holds_every_figure_and_assumption() -> None:
    page = study_page([MADE], ["one_shape.png"])
    assert page.count("\n| ") == 4
    for text in ("8.90 µrad", "the points are not printed", "- The points are on a circle.", "(one_shape.png)"):
        assert text in page


def test_an_upper_limit_is_kept_from_below() -> None:
    low, high = (Printed("angle", "Table 4", 1e-8, ours, "m", 0.0, at_most=True) for ours in (1e-10, 2e-8))
    assert (low.agrees, high.agrees) == (True, False)
    assert study_table(Study("two", "", (), (low,))).rows[0][2] == "< 0.0100 µm"
