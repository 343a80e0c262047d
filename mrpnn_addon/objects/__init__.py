"""Objects of a scene in plain terms: transforms, visibility, camera, lights, meshes and surfaces."""
