"""Volumetric path tracer: delta tracking, ratio tracking and next-event estimation."""
