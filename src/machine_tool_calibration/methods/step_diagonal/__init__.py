# SPDX-License-Identifier: Apache-2.0
"""Laser step diagonal: a linear interferometer on a flat mirror, diagonals as sequences of single-axis moves.

Ibaraki and Hata 2010, A new formulation of laser step diagonal measurement, Precision Engineering 34(3).
"""
