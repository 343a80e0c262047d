# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo: a volume rendered in Blender and compared with Cycles."""
