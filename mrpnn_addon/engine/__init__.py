"""The render engine: F12, the viewport, and the job that renders on a thread."""
