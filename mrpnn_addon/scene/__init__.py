"""The evaluated scene as `inference.render` takes it."""
