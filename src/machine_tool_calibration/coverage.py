# SPDX-License-Identifier: Apache-2.0
"""Expanded uncertainty (JCGM 100, 6.2)."""

COVERAGE = 0.9545
"""Coverage probability of an expanded uncertainty: that of k = 2 where a quantity is normal."""
K = 2.0
"""Coverage factor where degrees of freedom are many; where they count, the budget has another."""
