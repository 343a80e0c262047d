"""Layers in Blender and on disk: images, passes, OpenEXR files and compositing."""
