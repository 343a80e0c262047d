# SPDX-License-Identifier: GPL-3.0-or-later
"""The evaluated scene as `inference.render` takes it."""
