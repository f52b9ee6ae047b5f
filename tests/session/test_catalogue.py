# SPDX-License-Identifier: Apache-2.0
"""Methods that other packages bring."""

from pathlib import Path

import pytest

from machine_tool_calibration.session import catalogue

from ..own_method import announced, forget


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("circle_gauge = no_such_module:SPEC", "No module named"),
        ("circle_gauge = json:loads", "no MethodSpec"),
        ("probing = machine_tool_calibration.methods.probing.spec:SPEC", "already"),
    ],
)
def test_a_broken_plugin_is_skipped_with_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, why: str
) -> None:
    monkeypatch.syspath_prepend(str(announced(tmp_path / "site", line)))
    forget()
    try:
        with pytest.warns(UserWarning, match=f"the method plugin .* is skipped: .*{why}"):
            assert catalogue.method_names() == tuple(catalogue.METHODS)
    finally:
        forget()
