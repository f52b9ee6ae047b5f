# SPDX-License-Identifier: Apache-2.0
"""The certificate as pages: HTML, and PDF/A-3 that holds the result for programs as well."""

import base64
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

from machine_tool_calibration.certificate.dcc import dcc_text, lacks_for_dcc
from machine_tool_calibration.certificate.particulars import Certificate
from machine_tool_calibration.certificate.texts import facts, instruments, missing, procedure, statements
from machine_tool_calibration.errors import CalibrationError, one_line
from machine_tool_calibration.progress import Progress, untold
from machine_tool_calibration.report.evaluation import Evaluation
from machine_tool_calibration.report.page import pdf, rendered, save_all
from machine_tool_calibration.report.sections import Block, Section, Turnable, in_language, sections
from machine_tool_calibration.reports.documents import to_json
from machine_tool_calibration.reports.values import STANDARDS
from machine_tool_calibration.session.provenance import recorded_texts
from machine_tool_calibration.session.text import read_bytes
from machine_tool_calibration.words import Words

TEMPLATE = "certificate.html"
# Sections of the report that belong to a certificate: results, conformity, uncertainty, data. No diagnosis: what may be
# wrong with a machine is an opinion (ISO/IEC 17025, 7.8.7).
_RESULTS = (*STANDARDS, "map", "motions", "conformity", "budget", "undetermined", "rejected", "provenance")
_LARGEST_LOGO = 4 << 20
_KINDS = {b"\x89PNG": "png", b"\xff\xd8\xff": "jpeg", b"<": "svg+xml"}


def write_certificate(
    found: Evaluation,
    own: Certificate,
    words: Words,
    files: Sequence[Path],
    figures: Path | None = None,
    progress: Progress = untold,
) -> list[Path]:
    """Write a certificate; by its ending each file is HTML, PDF/A-3 or, .xml, a Digital Calibration Certificate (DCC).

    Returns the files, with those of the pictures in the folder `figures`.

    A CalibrationError: a file that cannot be written, no Pango for PDF, a template or logo that is none, or a DCC that
    lacks what its schema asks for.
    """
    progress("drawing", 0.0)
    enclosed = _enclosed(found, own, words)
    content = _sections(found, own, words, [name for name, *_ in enclosed])

    def made(ending: str) -> str | bytes:
        if ending == ".xml":
            return dcc_text(found, own, words)
        text = page(found, own, content, words, for_paper=ending == ".pdf")
        return pdf(text, enclosed, pdf_variant="pdf/a-3u") if ending == ".pdf" else text

    return save_all(files, made, content, figures, progress)


def page(found: Evaluation, own: Certificate, content: Sequence[Section], words: Words, *, for_paper: bool) -> str:
    """The certificate as an HTML page that holds all it needs; a CalibrationError for a template that is none."""
    from jinja2 import TemplateError

    origin, lacking, told = found.result.provenance, missing(own, found), words.numbers
    own_file = Path(own.template) if own.template else None
    if own_file is not None and own_file.name in (TEMPLATE, "report.html"):
        raise CalibrationError(f"{own_file}: a template that extends {TEMPLATE} needs another name")
    try:
        return rendered(
            own_file.name if own_file else TEMPLATE,
            str(__package__),
            *([own_file.parent] if own_file else []),
            own=own,
            words=words,
            facts=[(told(name), [told(line) for line in lines]) for name, lines in facts(own)],
            statements=[told(text) for text in statements(own, found) if text],
            draft=words("certificate.draft", points=lacking) if lacking else "",
            logo=_logo(own.laboratory.logo),
            sections=content,
            software=origin.software,
            footer=told(origin.footer),
            for_paper=for_paper,
        )
    except TemplateError as error:
        what = " ".join(str(error).split())
        raise CalibrationError(f"{own.template or TEMPLATE}: {type(error).__name__}: {what}") from None


def _sections(found: Evaluation, own: Certificate, words: Words, names: Sequence[str]) -> list[Section]:
    """What follows the first page; `names` are those of the files that a PDF holds."""
    made = []
    for name, tables in (("procedure", procedure(own, found)), ("instruments", instruments(own))):
        blocks: list[Block] = [in_language(table, words) for table in tables if table.rows]
        made.append(Section(name, words(f"certificate.section_{name}"), blocks))
    made += sections(found, words, _RESULTS)
    for section in made:
        section.blocks = [block for block in section.blocks if not isinstance(block, Turnable)]
    # of the data its sum: conditions stand above, and columns are those of the data
    made[-1].blocks[1:] = [words("certificate.enclosed", names=", ".join(names))]
    return [section for section in made if section.blocks]


def _enclosed(found: Evaluation, own: Certificate, words: Words) -> list[tuple[str, bytes, str]]:
    """Files that a PDF holds, and what each is to it: the result as `mtcal identify --json` has it, a DCC, the data."""
    files = [("result.json", to_json(found.document).encode(), "Data")]
    if not lacks_for_dcc(own):
        files.append(("dcc.xml", dcc_text(found, own, words), "Alternative"))
    labels = found.measured.chosen.labels or ("",)
    for label, session in zip(labels, found.measured.recorded, strict=True) if own.raw_data == "annex" else ():
        for name, text in zip(("session.yaml", "observations.csv"), recorded_texts(session), strict=True):
            files.append((f"{label}_{name}".lstrip("_"), text.encode(), "Source"))
    return files


def _logo(file: str) -> str:
    """A picture as an address that holds it; empty without one."""
    if not file:
        return ""
    content = read_bytes(Path(file), _LARGEST_LOGO)
    kind = next((kind for mark, kind in _KINDS.items() if content.lstrip().startswith(mark)), None)
    if kind is None:
        raise CalibrationError(f"{file}: a logo is an SVG, PNG or JPEG file")
    if kind != "svg+xml":
        from PIL import Image

        try:
            with Image.open(BytesIO(content)) as picture:
                picture.load()
        except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
            raise CalibrationError(f"{file}: the logo cannot be read: {one_line(error)}") from None
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"
