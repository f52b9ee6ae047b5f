# SPDX-License-Identifier: Apache-2.0
"""Papers' figures beside ours: the record, the table, the page."""

from papers.page import study_page, study_table, verdict_of
from papers.record import Printed, Study

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
