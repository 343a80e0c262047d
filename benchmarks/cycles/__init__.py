# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes and sequences rendered in Blender and compared with Cycles."""
