# SPDX-License-Identifier: Apache-2.0
"""Papers reproduced, as tables for people and as the page of the documentation."""

from __future__ import annotations

from collections.abc import Sequence

from machine_tool_calibration.reports.quantities import quantity
from machine_tool_calibration.reports.tables import TextTable
from papers.record import Printed, Study

__all__ = ["study_page", "study_table", "verdict_of"]

_HEADS = ("quantity", "in the paper", "paper", "ours", "equal within", "", "remark")
_ANSWERS = {True: "yes", False: "no", None: ""}


def study_table(study: Study) -> TextTable:
    """The figures of a paper beside ours."""
    note = "; ".join(text.rstrip(".") for text in study.assumptions)
    return TextTable(
        study.paper, _HEADS, tuple(_row(entry) for entry in study.printed), f"assumed: {note}" if note else ""
    )


def verdict_of(study: Study) -> str:
    """How many of the figures agree, in a sentence."""
    known = [entry.agrees for entry in study.printed if entry.agrees is not None]
    return f"{study.id}: {sum(known)} of {len(known)} figures agree"


def study_page(studies: Sequence[Study], pictures: Sequence[str] = ()) -> str:
    """All studies as a page in Markdown.

    Args:
        studies: in their order.
        pictures: names of picture files beside the page; each begins with its study's name.
    """
    parts = [
        "# The papers, reproduced\n",
        "Made by `python benchmarks/validate.py --page FILE`. Figures count as equal within what rounding and our own "
        "chance leave.\n",
    ]
    for study in studies:
        parts += [f"## {_words(study.id)}\n", f"{study.paper}\n", "| " + " | ".join(_HEADS) + " |"]
        parts.append("|---" * len(_HEADS) + "|")
        parts += ["| " + " | ".join(text.replace("|", "\\|") for text in _row(entry)) + " |" for entry in study.printed]
        parts.append(f"\n{verdict_of(study)}.\n")
        if study.assumptions:
            parts += ["Assumed, since the paper does not print it:\n", *(f"- {text}" for text in study.assumptions), ""]
        parts += [f"![{_words(name)}]({name})\n" for name in pictures if name.startswith(study.id)]
    return "\n".join(parts)


def _words(name: str) -> str:
    """What a picture shows, from its file's name."""
    return name.partition(".")[0].replace("_", " ")


def _row(entry: Printed) -> tuple[str, ...]:
    paper, ours = ("–" if value is None else quantity(value, entry.unit) for value in (entry.paper, entry.ours))
    if entry.at_most and entry.paper is not None:
        paper = f"< {paper}"
    within = quantity(entry.within, entry.unit) if entry.agrees is not None else ""
    return (entry.what, entry.where, paper, ours, within, _ANSWERS[entry.agrees], entry.why)
