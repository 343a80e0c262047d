"""Threads, processes and complete files, shared by the other rooms."""
