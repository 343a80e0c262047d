"""Shader nodes and volume materials, evaluated at many points as Cycles evaluates them."""
