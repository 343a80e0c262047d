# SPDX-License-Identifier: GPL-3.0-or-later
"""Six-way light maps: their errors, their cost, and the picture of their page."""
