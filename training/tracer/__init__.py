# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumetric path tracer: delta tracking, ratio tracking and next-event estimation."""
