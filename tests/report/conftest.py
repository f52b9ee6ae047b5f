# SPDX-License-Identifier: Apache-2.0
from ..coarse import found_once

__all__ = ["found_once"]
