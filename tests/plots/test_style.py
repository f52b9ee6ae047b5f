# SPDX-License-Identifier: Apache-2.0
"""What all pictures share."""

from io import BytesIO

import numpy as np
from matplotlib.image import imread

from machine_tool_calibration.plots.style import add_footer, new_figure


def test_a_legend_at_the_edge_stays_off_the_footer() -> None:
    figure = new_figure(4.0, 3.0)
    (line,) = figure.subplots().plot([0, 1])
    figure.legend([line], ["x"], loc="outside lower center", labelcolor="magenta", prop={"size": 20})
    area = add_footer(figure, "what it was made from " * 20)
    file = BytesIO()
    figure.savefig(file, dpi=100, bbox_inches=area)
    file.seek(0)
    picture = imread(file)[:, :, :3]
    magenta = np.abs(picture - (1.0, 0.0, 1.0)).max(axis=2) < 0.3
    strip = int(len(picture) * -area.y0 / area.height)
    assert magenta.any() and not magenta[len(picture) - strip :].any()
