# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles as a path-traced reference, in this process or a separate one."""
