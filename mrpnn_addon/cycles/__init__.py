"""Cycles as a path-traced reference, rendered in this process or one of its own."""
