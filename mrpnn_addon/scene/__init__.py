"""The evaluated scene as the descriptions that `inference.render` takes."""
