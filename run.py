# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands of a fresh checkout, with nothing but Python 3.11 installed.

    python3.11 run.py demo [volume.vdb ...]            render in Blender, compare with Cycles
    python3.11 run.py test [--all] [pytest options]    run the quick tests, or all of them
    python3.11 run.py release [0.2.0]                  set the version, and build the zips and wheels of a release

All install what they need, pinned, into .venv beside this file, and compile the kernels for this machine.
"""

import hashlib
import os
import re
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
PYTHON = VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python")

COMMANDS = {
    "demo": ("requirements.txt", ["-m", "benchmarks.demo"]),
    "release": ("requirements.txt", ["-m", "packages.release"]),
    # Two processes, each with whole files, in the order of tests/conftest.py.
    "test": ("requirements-dev.txt", ["-m", "pytest", "-n", "2", "--dist", "loadgroup", "--no-loadscope-reorder"]),
}


def install(requirements: str) -> None:
    """Create .venv if need be and install `requirements` unless that very list is in already."""
    included = re.findall(r"^-r (.+)$", (ROOT / requirements).read_text(), re.MULTILINE)
    text = "".join((ROOT / name).read_text() for name in sorted({requirements, *included}))
    stamp = VENV / f"installed-{requirements}"
    wanted = hashlib.sha256(text.encode()).hexdigest()
    if stamp.exists() and stamp.read_text() == wanted:
        return
    print(f"installing {requirements} into {VENV.name}; the first time takes minutes", flush=True)
    if not PYTHON.exists():
        venv.create(VENV, with_pip=True)
    subprocess.run(
        [
            PYTHON,
            "-m",
            "pip",
            "install",
            "--quiet",
            "--quiet",
            "--disable-pip-version-check",
            "--requirement",
            ROOT / requirements,
        ],
        check=True,
    )
    stamp.write_text(wanted)


def main() -> int:
    if len(sys.argv) < 2 or sys.argv[1] not in COMMANDS:
        print(__doc__)
        return 2
    if sys.version_info[:2] != (3, 11):
        print(f"Blender 4.5 needs Python 3.11; this is {sys.version.split()[0]}. Start with: python3.11 run.py")
        return 2
    requirements, command = COMMANDS[sys.argv[1]]
    try:
        install(requirements)
        # Here, so that no timed render waits for the compiler. Where it fails, the first render says what to do.
        subprocess.run([PYTHON, "-m", "inference.kernels"], cwd=ROOT, stdout=subprocess.DEVNULL)
    except subprocess.CalledProcessError as error:
        print(f"Installing {requirements} failed; see pip's message above")
        return error.returncode
    # Volume paths on the command line are relative to where the user stands, modules to ROOT.
    arguments = [os.path.abspath(a) if sys.argv[1] == "demo" and a.endswith(".vdb") else a for a in sys.argv[2:]]
    return subprocess.run([PYTHON, *command, *arguments], cwd=ROOT).returncode


if __name__ == "__main__":
    sys.exit(main())
