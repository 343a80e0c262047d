"""Density grids of .vdb files, read in a process of their own."""
