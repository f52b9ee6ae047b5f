# SPDX-License-Identifier: Apache-2.0
"""Records, arrays and numbers in the types of JSON; without NumPy, which half of the commands do without."""

import dataclasses
import math
from collections.abc import Mapping, Set
from datetime import date, datetime
from enum import Enum
from pathlib import PurePath
from typing import Any


def plain(value: Any) -> Any:
    """The value in the types of JSON: records as objects, arrays as lists, NaN and infinities as None."""
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, Enum):
        return plain(value.value)
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, Set):
        return [plain(entry) for entry in sorted(value)]
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, datetime | date):
        return value.isoformat()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if getattr(getattr(value, "dtype", None), "kind", "") == "f" and math.isfinite(value.sum()):
        return value.tolist()  # a map may have a hundred thousand points, seldom one that is not determined
    for method in ("model_dump", "tolist"):  # a pydantic record; an array or a scalar of NumPy
        if hasattr(value, method):
            return plain(getattr(value, method)())
    raise TypeError(f"a {type(value).__name__} cannot be written as JSON")
