"""Cycles as a path-traced reference, in this process or a separate one."""
