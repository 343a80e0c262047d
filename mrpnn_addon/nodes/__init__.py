# SPDX-License-Identifier: GPL-3.0-or-later
"""Shader nodes and volume materials, evaluated at many points as Cycles evaluates them."""
