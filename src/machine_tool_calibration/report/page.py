# SPDX-License-Identifier: Apache-2.0
"""The report as one HTML page that holds all it needs, and as a PDF of the same."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.report.figures import Picture, library
from machine_tool_calibration.report.sections import Section, Turnable, sections
from machine_tool_calibration.reports.tables import TextTable
from machine_tool_calibration.session.provenance import name_of_machine
from machine_tool_calibration.words import Words

if TYPE_CHECKING:
    from machine_tool_calibration.report.evaluation import Evaluation

# Control characters, which no text needs and a terminal obeys, become the sign for one that cannot be shown.
_UNPRINTABLE = dict.fromkeys({*range(0x20), *range(0x7F, 0xA0)} - {0x09, 0x0A, 0x0D}, "\ufffd")


def write_report(
    found: Evaluation,
    words: Words,
    files: Sequence[Path],
    figures: Path | None = None,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> list[Path]:
    """Write a report.

    Returns:
        The files.

    Raises:
        CalibrationError: another ending, a file that cannot be written, or no Pango for PDF.
    """
    check_endings(files)
    progress("drawing", 0.0)
    content = sections(found, words)
    try:
        for k, file in enumerate(files, start=1):
            progress(f"writing {file.name}", k / (len(files) + 1))
            file.parent.mkdir(parents=True, exist_ok=True)
            if file.suffix.lower() == ".pdf":
                file.write_bytes(_pdf(html(found, content, words, for_paper=True)))
            else:
                file.write_text(html(found, content, words), encoding="utf-8")
        return [*files, *(save_pictures(content, figures) if figures else ())]
    except OSError as error:
        raise CalibrationError(f"{error.filename or files[0]}: cannot be written: {error.strerror}") from None


def check_endings(files: Sequence[Path]) -> None:
    """Refuse what a report cannot be, before it is calculated.

    Raises:
        CalibrationError: a file that is neither .html nor .pdf.
    """
    for file in files:
        if file.suffix.lower() not in (".html", ".pdf"):
            raise CalibrationError(f"{file}: a report is an .html or a .pdf file")


def html(found: Evaluation, content: Sequence[Section], words: Words, *, for_paper: bool = False) -> str:
    """The page; on paper nothing in it can be turned."""
    origin = found.result.provenance
    drawings = [block.drawing for section in content for block in section.blocks if isinstance(block, Turnable)]
    interactive = bool(drawings) and not for_paper
    if for_paper:  # where nothing can be turned
        content = [own for own in content if not all(isinstance(block, Turnable) for block in own.blocks)]
    machines = [name_of_machine(one.about) for one in origin.sessions]
    return rendered(
        "report.html",
        words=words,
        sections=content,
        software=origin.software,
        evaluated=words.numbers(origin.evaluated[:10]),
        footer=words.numbers(words.told(origin.footer)),
        machine=", ".join(dict.fromkeys(name for name in machines if name)),
        measured=words.numbers(", ".join(dict.fromkeys(one.measured for one in origin.sessions if one.measured))),
        for_paper=for_paper,
        # no `</script>` in it can end the script
        drawings=json.dumps(drawings).replace("</", "<\\/") if interactive else "",
        library=library() if interactive else "",
    )


def rendered(template: str, *packages: str, **values: Any) -> str:
    """A page made of a template.

    Args:
        template: its file; it may extend `report.html`.
        packages: where it is, beside this one.
        values: that it takes.
    """
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package, ".") for package in (str(__package__), *packages)]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.tests["picture"] = lambda block: isinstance(block, Picture)
    environment.tests["table"] = lambda block: isinstance(block, TextTable)
    environment.tests["turnable"] = lambda block: isinstance(block, Turnable)
    return environment.get_template(template).render(**values).translate(_UNPRINTABLE)


def save_pictures(content: Sequence[Section], folder: Path) -> list[Path]:
    """Write the pictures as SVG files of their names."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for block in (block for section in content for block in section.blocks):
        if isinstance(block, Picture):
            written.append(folder / f"{block.name.replace('/', '-')}.svg")
            written[-1].write_bytes(block.svg)
    return written


def _pdf(page: str) -> bytes:
    try:
        from weasyprint import HTML  # type: ignore[import-untyped]
        from weasyprint.urls import URLFetcher  # type: ignore[import-untyped]
    except OSError:  # it loads Pango when it is imported
        raise CalibrationError("a PDF needs the library Pango (Debian: libpangoft2-1.0-0); HTML does not") from None
    # all of it is in the page
    made: bytes = HTML(string=page, url_fetcher=URLFetcher(allowed_protocols=["data"])).write_pdf()
    return made
