# SPDX-License-Identifier: GPL-3.0-or-later
"""Training data: rows of descriptors of procedural volumes, with path-traced targets."""
