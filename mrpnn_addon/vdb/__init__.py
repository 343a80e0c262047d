# SPDX-License-Identifier: GPL-3.0-or-later
"""Density grids of .vdb files, read by a separate process."""
