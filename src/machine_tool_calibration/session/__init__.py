# SPDX-License-Identifier: Apache-2.0
"""A measurement as it was recorded, and what is known of its method."""

DESCRIPTION_FILE, OBSERVATIONS_FILE = "session.yaml", "observations.csv"
"""Names of the files in a session's folder."""
