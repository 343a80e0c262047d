"""Transforms, visibility, cameras, lights, meshes and surfaces of a scene's objects."""
