# SPDX-License-Identifier: GPL-3.0-or-later
"""Error against run time, beside that of Cycles."""
