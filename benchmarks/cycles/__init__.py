"""Scenes and sequences rendered in Blender and compared with Cycles."""
