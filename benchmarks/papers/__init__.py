# SPDX-License-Identifier: Apache-2.0
"""What the four papers print, beside what this package finds for the same measurement."""
