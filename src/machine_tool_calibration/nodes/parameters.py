"""Parameters with description, unit and range."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from machine_tool_calibration.errors import CalibrationError

__all__ = ["declare"]


def declare(
    node: Node,
    name: str,
    default: Any,
    description: str,
    *,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
    read_only: bool = True,
) -> Any:
    """Declare a parameter and return its value.

    Args:
        node: whose parameter it is.
        name: its name.
        default: its value where nobody sets it; gives the type.
        description: what it does.
        unit: of a number.
        low: least value.
        high: greatest value.
        choices: of a text.
        read_only: whether it can be set at the start only.
    """
    descriptor = ParameterDescriptor(
        name=name,
        description=f"{description} [{unit}]" if unit else description,
        read_only=read_only,
        additional_constraints=f"one of {', '.join(choices)}" if choices else "",
    )
    if low is not None or high is not None:
        low, high = (-1e308 if low is None else low), (1e308 if high is None else high)
        if isinstance(default, float):
            descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
        elif isinstance(default, int):
            low, high = max(low, -(2**63)), min(high, 2**63 - 1)
            descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high))]
    value = node.declare_parameter(name, default, descriptor).value
    if choices and value not in choices:
        raise CalibrationError(f"parameter {name} is {value!r}, not one of {', '.join(choices)}")
    return value
