# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render costs in time and memory, and how cost grows with the scene."""
