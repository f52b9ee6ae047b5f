# SPDX-License-Identifier: Apache-2.0
"""Chains as ISO 10791 and the papers write them."""

import pytest

from machine_tool_calibration.machine.chain import Chain


@pytest.mark.parametrize(
    ("text", "workpiece_side", "tool_side"),
    [
        ("w-X-Y-b-Z-t", "XY", "Z"),
        ("w-C-b-Y-X-Z-t", "C", "YXZ"),
        ("V[w-C-A-b-Y-X-Z-(C)-t]", "CA", "YXZ"),
        ("  w-b-X-t ", "", "X"),
        ("w-Z-b-t", "Z", ""),
        ("w-C2-b-X-t".replace("C2", "C"), "C", "X"),
    ],
)
def test_parse(text, workpiece_side, tool_side):
    chain = Chain.parse(text)
    assert Chain.parse(str(chain)) == chain
    assert chain.workpiece_side == tuple(workpiece_side)
    assert chain.tool_side == tuple(tool_side)
    assert chain.axes == tuple(workpiece_side + tool_side)


def test_linear_and_rotary_axes():
    chain = Chain.parse("w-C-A-b-Y-X-Z-t")
    assert chain.linear == ("Y", "X", "Z")
    assert chain.rotary == ("C", "A")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("X-Y-b-Z", "must run from w"),
        ("w-X-Y-Z-t", "one b"),
        ("w-X-b-Y-b-t", "one b"),
        ("w-X-Q-b-t", "unknown axis 'Q'"),
        ("w-X-b-X-t", "names an axis twice"),
        ("w-x-b-t", "unknown axis 'x'"),
        ("", "must run from w"),
    ],
)
def test_not_a_chain(text, message):
    with pytest.raises(ValueError, match=message):
        Chain.parse(text)
