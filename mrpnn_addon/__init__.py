"""Between Blender and `inference`: the scene is read here, and layers are handed back here."""
