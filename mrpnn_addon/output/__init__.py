# SPDX-License-Identifier: GPL-3.0-or-later
"""Layers in Blender and on disk: images, passes, OpenEXR files and compositing."""
