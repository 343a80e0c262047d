"""Shader nodes, evaluated at many points as Cycles evaluates them, and the materials they make."""
