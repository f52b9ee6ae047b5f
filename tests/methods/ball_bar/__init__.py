# SPDX-License-Identifier: Apache-2.0
"""A sixth measuring method as a package of its own adds it: circles with a double ball bar."""
