"""The line that every table of figures carries: the command, the weights and the commit that made it."""

import hashlib
import shlex
import subprocess
import sys
from typing import Optional, Sequence

from .data import ROOT

# Hexadecimal digits of a checksum or a commit that are shown.
DIGITS = 12


def made_by(program: str, arguments: Optional[Sequence] = None, models: Sequence[str] = ("mrpnn",)) -> str:
    """For example: `python -m benchmarks.cost.speed --size 256`; weights mrpnn 0123456789ab; commit 0123456789ab.

    arguments: the command line's without. models: names of the networks whose weights were measured; those that have
    no weights, as the path tracer, are not named.
    """
    command = shlex.join(["python", "-m", program, *map(str, sys.argv[1:] if arguments is None else arguments)])
    parts = [f"`{command}`"]
    known = [f"{name} {checksum}" for name, checksum in ((name, weights_checksum(name)) for name in models) if checksum]
    if known:
        parts.append("weights " + ", ".join(known))
    return "; ".join([*parts, commit()])


def weights_checksum(model: str) -> str:
    """First digits of the sha256 of a network's weights; "" where it has none."""
    from inference.network import network

    path = network.WEIGHTS / f"{model}.onnx"
    return hashlib.sha256(path.read_bytes()).hexdigest()[:DIGITS] if path.is_file() else ""


def commit() -> str:
    """The commit of the repository, and whether files other than docs, where tables are written, differ from it."""
    try:
        head = _git("rev-parse", f"--short={DIGITS}", "HEAD").strip()
        changed = _git("status", "--porcelain", "--", ".", ":!docs").strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown commit"
    return f"commit {head}" + (" with local changes" if changed else "")


def _git(*arguments) -> str:
    return subprocess.run(["git", *arguments], cwd=ROOT, check=True, text=True, stdout=subprocess.PIPE,
                          stderr=subprocess.DEVNULL).stdout
