# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth of field and motion blur: where rays pass the lens and when, and what joins the pixels again."""
