# SPDX-License-Identifier: GPL-3.0-or-later
"""Training: procedural volumes, path-traced targets, networks. Not shipped with the extension."""
