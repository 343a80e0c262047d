"""Training data: procedural volumes, and rows of descriptors with path-traced targets."""
