# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth of field and motion blur: where and when rays pass the lens, and what joins the pixels again."""
