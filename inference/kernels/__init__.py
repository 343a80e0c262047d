# SPDX-License-Identifier: GPL-3.0-or-later
"""Compiled kernels: C sources, the structures that they share with Python, and the library that holds them."""
