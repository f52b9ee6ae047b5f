# SPDX-License-Identifier: Apache-2.0
"""Sentences of an identification: how well the model fits, and what shares a reason."""

from machine_tool_calibration.reports.identification import goodness_of_fit, group_by_reason


def test_goodness_of_fit():
    assert "within their declared" in goodness_of_fit({"reduced_chi_square": 1.0, "p_value": 0.5})
    assert "scatter 2.00 times" in goodness_of_fit({"reduced_chi_square": 4.0, "p_value": 1e-9})
    assert "p < 1e-6" in goodness_of_fit({"reduced_chi_square": 4.0, "p_value": 0.0})
    assert "nearly within" in goodness_of_fit({"reduced_chi_square": 1.15, "p_value": 0.007})
    assert "stated too large" in goodness_of_fit({"reduced_chi_square": 0.25, "p_value": 0.99999})


def test_names_that_share_a_reason():
    assert group_by_reason([("a", "why"), ("b", "because"), ("c", "why")]) == [("why", "a, c"), ("because", "b")]
    assert group_by_reason((str(k), "lost") for k in range(20))[0][1].endswith("7 and 12 more")
