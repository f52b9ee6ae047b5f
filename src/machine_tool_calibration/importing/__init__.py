# SPDX-License-Identifier: Apache-2.0
"""Tables of other programs (coordinate measuring machines, laser trackers, interferometers) as sessions."""
