# SPDX-License-Identifier: GPL-3.0-or-later
"""Volume objects, closed meshes and fluid domains as density grids."""
