# SPDX-License-Identifier: Apache-2.0
"""What the records of all files have in common, and numbers whose size is not checked."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Record(BaseModel):
    """A frozen record that accepts no unknown key; its checks are made when one is first read, as that takes long."""

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)
