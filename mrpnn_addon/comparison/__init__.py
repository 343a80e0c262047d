# SPDX-License-Identifier: GPL-3.0-or-later
"""Comparisons of MRPNN with Cycles: plan, passes, figures and report."""
