# SPDX-License-Identifier: GPL-3.0-or-later
"""The render engine: F12, rendered viewports, and render jobs on a thread."""
