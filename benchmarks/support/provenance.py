# SPDX-License-Identifier: GPL-3.0-or-later
"""The sentence that every table of figures carries: the weights, the commit and the command that made it."""

import hashlib
import shlex
import subprocess
import sys
from collections.abc import Sequence

from .data import ROOT

# Hexadecimal digits of a checksum that are shown.
DIGITS = 12


def made_by(program: str, arguments: Sequence | None = None, models: Sequence[str] = ("mrpnn",)) -> str:
    """For example: Weights `mrpnn` 0123456789ab, commit 0123456, `python -m benchmarks.cost.speed --size 256`.

    arguments: by default the command line's. models: names of the networks that were measured; those without weights,
    such as the path tracer, are not named.
    """
    command = shlex.join(["python", "-m", program, *map(str, sys.argv[1:] if arguments is None else arguments)])
    checksums = {model: weights_checksum(model) for model in models}
    weights = [f"`{model}` {checksum}" for model, checksum in checksums.items() if checksum]
    parts = [f"weights {', '.join(weights)}"] if weights else []
    sentence = ", ".join([*parts, commit(), f"`{command}`"]) + "."
    return sentence[0].upper() + sentence[1:]


def weights_checksum(model: str) -> str:
    """First digits of the sha256 of a network's weights; "" where it has none."""
    from inference.models import weights_file
    from training.rpnn import WEIGHTS

    paths = [folder / f"{model}.onnx" for folder in (weights_file.WEIGHTS, WEIGHTS)]
    found = [hashlib.sha256(path.read_bytes()).hexdigest()[:DIGITS] for path in paths if path.is_file()]
    return found[0] if found else ""


def commit() -> str:
    """The commit of the repository, and whether files other than docs, where tables are written, differ from it."""
    try:
        head = _git("rev-parse", "--short", "HEAD").strip()
        changed = _git("status", "--porcelain", "--", ".", ":!docs").strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown commit"
    return f"commit {head}" + (" with local changes" if changed else "")


def _git(*arguments) -> str:
    return subprocess.run(
        ["git", *arguments], cwd=ROOT, check=True, text=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ).stdout
