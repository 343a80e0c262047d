# SPDX-License-Identifier: GPL-3.0-or-later
"""What panels show: forecasts, checks, and the last render and comparison of the open file."""
