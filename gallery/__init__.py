# SPDX-License-Identifier: GPL-3.0-or-later
"""Eleven scenes with volumes, made by scripts: .blend files, .vdb files, pictures, a page and templates."""
