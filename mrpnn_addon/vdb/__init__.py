"""Density grids of .vdb files, read by a separate process."""
