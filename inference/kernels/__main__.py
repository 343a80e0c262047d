# SPDX-License-Identifier: GPL-3.0-or-later
"""Compile the kernels for one platform, or for all that the extension supports, and print the libraries' paths.

.venv/bin/python -m inference.kernels [--platform windows-x64 | all]
"""

import argparse
import sys

from .build import BUILD, SHIPPED, TARGETS, BuildError, build, this_platform


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m inference.kernels", description="Compile the kernels.")
    parser.add_argument("--platform", choices=[*TARGETS, "all"], default=this_platform())
    wanted = parser.parse_args().platform
    for name in SHIPPED if wanted == "all" else [wanted]:
        try:
            path = build(name)
        except BuildError as error:
            print(f"No kernels for {name}: {error}", file=sys.stderr)
            return 1
        print(f"{path.relative_to(BUILD.parents[1])}  {path.stat().st_size / 1e3:.0f} KB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
