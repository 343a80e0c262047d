# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of scenes, view layers and this machine."""
