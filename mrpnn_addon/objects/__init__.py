# SPDX-License-Identifier: GPL-3.0-or-later
"""Transforms, visibility, cameras, lights, meshes and surfaces of a scene's objects."""
