# SPDX-License-Identifier: GPL-3.0-or-later
"""The World: its light as a few directions, and its picture, rendered by Cycles in another process."""
