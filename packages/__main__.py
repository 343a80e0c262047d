# SPDX-License-Identifier: GPL-3.0-or-later
import argparse
import sys

from .kernels import build_sdist, build_wheel, load_build
from .metadata import ROOT


def main() -> int:
    build = load_build()
    parser = argparse.ArgumentParser(prog="python -m packages", description="Build the wheels of mrpnn-kernels.")
    parser.add_argument("--platform", choices=[*build.TARGETS, "all"], default=build.this_platform())
    wanted = parser.parse_args().platform
    try:
        made = [build_wheel(name, ROOT / "wheels") for name in (build.SHIPPED if wanted == "all" else [wanted])]
    except build.BuildError as error:
        print(f"No wheel: {error}", file=sys.stderr)
        return 1
    if wanted == "all":
        made.append(build_sdist(ROOT / "wheels"))
    for path in made:
        print(f"{path.relative_to(ROOT)}  {path.stat().st_size / 1e3:.0f} KB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
