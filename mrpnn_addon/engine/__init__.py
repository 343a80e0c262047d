"""The render engine: F12, rendered viewports, and render jobs on a thread."""
