"""Training: procedural volumes, path-traced targets, networks. Not shipped with the extension."""
