"""Comparisons of MRPNN with Cycles: their plan, their passes, and the report."""
