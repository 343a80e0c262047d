# SPDX-License-Identifier: GPL-3.0-or-later
"""Where tests find the repository and what may lie beside it."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# Real volumes, independent references and the tools that make Blenders with a window; tests skip without them.
SHARED = ROOT.parent / "shared"
