# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors in a scene's description."""


class SceneError(ValueError):
    """The scene cannot be rendered as described; the message tells the user what to change."""
