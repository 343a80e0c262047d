"""Threads, processes and files: what every other room may need; nothing of the renderer."""
