# SPDX-License-Identifier: GPL-3.0-or-later
"""Procedural volumes: noise, fluids, solids, and the kinds that data are made of."""
