# SPDX-License-Identifier: GPL-3.0-or-later
"""The compiled kernels of MRPNN Volumes: one library, which `mrpnn` finds by itself and loads with ctypes."""
