# SPDX-License-Identifier: GPL-3.0-or-later
"""Extreme scenes and single stages, each against an independent result and within a stated bound."""
