# SPDX-License-Identifier: Apache-2.0
"""A measuring method as a package of its own adds it: circles with a length gauge between table and tool."""
