# SPDX-License-Identifier: GPL-3.0-or-later
"""Error against path-traced references, in the form of the tables of the paper."""
