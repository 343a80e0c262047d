"""The demo: a volume rendered in Blender and compared with Cycles."""
