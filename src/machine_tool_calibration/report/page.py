# SPDX-License-Identifier: Apache-2.0
"""The report as one HTML page that holds all it needs, and as a PDF of the same."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.files import save
from machine_tool_calibration.progress import Progress, untold
from machine_tool_calibration.report.evaluation import Evaluation
from machine_tool_calibration.report.figures import Picture, library
from machine_tool_calibration.report.sections import Section, Turnable, sections
from machine_tool_calibration.reports.tables import TextTable
from machine_tool_calibration.session.provenance import name_of_machine
from machine_tool_calibration.words import Words

# Control characters, which no text needs and a terminal obeys, and what XML cannot hold become the sign for a
# character that cannot be shown.
_UNPRINTABLE = dict.fromkeys({*range(0x20), *range(0x7F, 0xA0), 0xFFFE, 0xFFFF} - {0x09, 0x0A, 0x0D}, "\ufffd")


def write_report(
    found: Evaluation, words: Words, files: Sequence[Path], figures: Path | None = None, progress: Progress = untold
) -> list[Path]:
    """The files of a report. A CalibrationError: another ending, one that cannot be written, no Pango for PDF."""
    check_endings(files)
    progress("drawing", 0.0)
    content = sections(found, words)

    def made(ending: str) -> str | bytes:
        return pdf(html(found, content, words, for_paper=True)) if ending == ".pdf" else html(found, content, words)

    return save_all(files, made, content, figures, progress)


def save_all(
    files: Sequence[Path],
    made: Callable[[str], str | bytes],
    content: Sequence[Section],
    figures: Path | None,
    progress: Progress,
) -> list[Path]:
    """Write files, each made by its ending, and the pictures as SVG in a folder if one is given; returns all."""
    for k, file in enumerate(files, start=1):
        progress(f"writing {file.name}", k / (len(files) + 1))
        save(file, made(file.suffix.lower()))
    if figures is None:
        return list(files)
    every = [block for section in content for block in section.blocks if isinstance(block, Picture)]
    return [*files, *(save(figures / f"{one.name.replace('/', '-')}.svg", one.svg) for one in every)]


def check_endings(files: Sequence[Path], *, certificate: bool = False) -> None:
    """Refuse what a report cannot be, before it is calculated.

    A CalibrationError: a file that is neither .html nor .pdf, nor .xml of a certificate.
    """
    for file in files:
        if file.suffix.lower() == ".xml" and not certificate:
            raise CalibrationError(f"{file}: a Digital Calibration Certificate needs --certificate FILE")
        if file.suffix.lower() not in (".html", ".pdf", ".xml"):
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
        footer=words.numbers(origin.footer),
        machine=", ".join(dict.fromkeys(name for name in machines if name)),
        measured=words.numbers(", ".join(dict.fromkeys(one.measured for one in origin.sessions if one.measured))),
        for_paper=for_paper,
        # no `</script>` in it can end the script
        drawings=json.dumps(drawings).replace("</", "<\\/") if interactive else "",
        library=library() if interactive else "",
    )


def rendered(template: str, *packages: str | Path, **values: Any) -> str:
    """A page made of a template, which may extend `report.html`, and the values that it takes.

    It is in one of the packages, or in this one; a folder of the user's is given as a path.
    """
    from jinja2 import ChoiceLoader, FileSystemLoader, PackageLoader, StrictUndefined
    from jinja2.sandbox import SandboxedEnvironment

    places = (str(__package__), *packages)
    loaders = [FileSystemLoader(one) if isinstance(one, Path) else PackageLoader(one, ".") for one in places]
    environment = SandboxedEnvironment(
        loader=ChoiceLoader(loaders), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.globals.update(for_paper=False, drawings="", library="")
    environment.tests["picture"] = lambda block: isinstance(block, Picture)
    environment.tests["table"] = lambda block: isinstance(block, TextTable)
    environment.tests["turnable"] = lambda block: isinstance(block, Turnable)
    return environment.get_template(template).render(**values).translate(_UNPRINTABLE)


def pdf(page: str, files: Sequence[tuple[str, bytes, str]] = (), **options: Any) -> bytes:
    """A page of HTML that holds all it needs on paper, with options of WeasyPrint's `write_pdf`.

    Of files that it holds: name, content, and what each is to the page (`AFRelationship` of ISO 19005-3). A
    CalibrationError: no Pango.
    """
    try:
        from weasyprint import HTML, Attachment  # type: ignore[import-untyped]
        from weasyprint.urls import URLFetcher  # type: ignore[import-untyped]
    except OSError:  # it loads Pango when it is imported
        raise CalibrationError("a PDF needs the library Pango (Debian: libpangoft2-1.0-0); HTML does not") from None
    attachments = [Attachment(string=content, name=name, relationship=relation) for name, content, relation in files]
    # all of it is in the page
    fetcher = URLFetcher(allowed_protocols=["data"])
    made: bytes = HTML(string=page, url_fetcher=fetcher).write_pdf(attachments=attachments, **options)
    return made
