# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's procedural textures in NumPy, with the values that Cycles gives them."""
