# SPDX-License-Identifier: GPL-3.0-or-later
"""Training data: procedural volumes, and rows of descriptors with path-traced targets."""
