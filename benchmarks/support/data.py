# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the benchmarks' volumes and references are: in the repository, but for what may not be copied into it."""

from pathlib import Path

from .extension import ROOT

#: See benchmarks/data/README.md for what they are, their sources and their licences.
VOLUMES = ROOT / "benchmarks" / "data" / "volumes"
REFERENCES = ROOT / "benchmarks" / "data" / "references"
#: Volumes without a licence to copy them, beside the repository. Optional: programs leave out what needs an absent one.
EXTRA_VOLUMES = ROOT.parent / "shared" / "volumes"


def volume_file(name: str) -> Path:
    """The path of a .vdb file: in the repository where it is there, otherwise where it is looked for as an extra."""
    path = VOLUMES / name
    return path if path.exists() else EXTRA_VOLUMES / name
