# SPDX-License-Identifier: Apache-2.0
"""The report of a measurement to hand over: one HTML file or a PDF, in several languages."""
