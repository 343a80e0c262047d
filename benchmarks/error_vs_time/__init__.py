"""Error against run time, beside that of Cycles."""
