# SPDX-License-Identifier: GPL-3.0-or-later
"""Threads, processes and complete files, shared by the other rooms."""
