"""Comparisons of MRPNN with Cycles: plan, passes, figures and report."""
