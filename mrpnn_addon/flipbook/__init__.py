# SPDX-License-Identifier: GPL-3.0-or-later
"""Six-way light maps of volumes, as flipbooks for games and for relighting."""
