# SPDX-License-Identifier: GPL-3.0-or-later
"""Programs that measure the renderer: its error, its cost, and what it does with extreme input.

Each room's programs are started as `python -m benchmarks.<room>` or `python -m benchmarks.<room>.<program>`.
"""
