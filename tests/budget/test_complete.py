# SPDX-License-Identifier: Apache-2.0
"""What follows from a diagnosis, as it is told while it is worked out."""

from typing import Any

import pytest

from machine_tool_calibration.budget import complete
from machine_tool_calibration.planning.what_to_measure import Advice


def test_conclusions_go_on_where_the_search_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the whole time a tenth for what the candidates would change, and the rest for what to measure next."""
    advice = Advice()

    def asked(found: object, progress: Any) -> Advice:
        for share in (0.0, 0.5, 1.0):
            progress("further", share)
        return advice

    monkeypatch.setattr(complete, "consequences", lambda found, added: {"play": found})
    monkeypatch.setattr(complete, "what_to_measure", asked)
    told: list[float] = []
    found: Any = "a diagnosis"
    done = complete.conclude(found, (), progress=lambda what, share: told.append(share))
    assert done.advice is advice and done.changes == {"play": found}
    assert told == pytest.approx([0.7, 0.8, 0.9, 1.0])
