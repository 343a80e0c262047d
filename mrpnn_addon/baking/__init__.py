# SPDX-License-Identifier: GPL-3.0-or-later
"""Predicted scattering, baked into light for Cycles and EEVEE."""
