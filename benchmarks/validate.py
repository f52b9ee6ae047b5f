# SPDX-License-Identifier: Apache-2.0
"""The figures that the four papers print, beside what this package finds for the same measurement.

What a paper does not print is assumed and said; where a figure does not come out the same, the reason stands beside it.

    python benchmarks/validate.py
    python benchmarks/validate.py rotary_axis --output pictures
    python benchmarks/validate.py --page docs/validation/index.md
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from papers import study_probing, study_rotary_axis, study_step_diagonal, study_tracking
from papers.page import study_page, study_table, verdict_of
from papers.pictures import save_pictures

from machine_tool_calibration.cli.shared import console, progress_bar
from machine_tool_calibration.reports.tables import show_table

STUDIES = {
    "probing": study_probing.study,
    "rotary_axis": study_rotary_axis.study,
    "step_diagonal": study_step_diagonal.study,
    "tracking": study_tracking.study,
}


def main() -> None:
    """Do the papers' calculations and simulations anew, print both, draw the pictures, write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="STUDY", help=f"{', '.join(STUDIES)}; all if none is given")
    parser.add_argument("-o", "--output", type=Path, help="folder for the papers' pictures, drawn from our results")
    parser.add_argument("--page", type=Path, help="write all of it in Markdown, with the pictures beside it")
    options = parser.parse_args()
    if unknown := [name for name in options.names if name not in STUDIES]:
        parser.error(f"no study {unknown[0]!r}; there are {', '.join(STUDIES)}")
    with progress_bar() as progress:
        studies = [
            STUDIES[name](partial(lambda name, what, share: progress(f"{name}: {what}", share), name))
            for name in options.names or STUDIES
        ]
    for entry in studies:
        show_table(console(), study_table(entry))
        console().print(verdict_of(entry))
    folder = options.output or (options.page.parent if options.page else None)
    pictures = [path.name for entry in studies for path in save_pictures(entry, folder)] if folder else []
    if options.page:
        options.page.write_text(study_page(studies, pictures), encoding="utf-8")


if __name__ == "__main__":
    main()
