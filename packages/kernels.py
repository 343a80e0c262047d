# SPDX-License-Identifier: GPL-3.0-or-later
"""The wheels and the source distribution of `mrpnn-kernels`."""

import importlib.util
import re
import tomllib
from pathlib import Path
from types import ModuleType

from .archives import write_sdist, write_wheel
from .metadata import KERNELS, ROOT, core_metadata, version

MODULE = "mrpnn_kernels"
#: Files of the source distribution that lie where they lie in the repository.
SHARED = (
    "packages/*.py",
    "packages/mrpnn_kernels/__init__.py",
    "inference/kernels/*.[ch]",
    "inference/kernels/build.py",
)


def load_build(root: Path = ROOT) -> ModuleType:
    """inference/kernels/build.py, without numpy and the rest of `inference`, which a building environment lacks."""
    spec = importlib.util.spec_from_file_location("mrpnn_build", root / "inference" / "kernels" / "build.py")
    if spec is None or spec.loader is None:
        raise FileNotFoundError("inference/kernels/build.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def wheel_name(platform: str) -> str:
    """File name of the wheel for one of Blender's platforms."""
    return f"{MODULE}-{version()}-py3-none-{load_build().TARGETS[platform].tag}.whl"


def build_wheel(platform: str, folder: Path) -> Path:
    """Compile the kernels for a platform and write their wheel into a folder; returns its path. Raises BuildError."""
    project = tomllib.loads(KERNELS.read_text())["project"] | {"version": version()}
    source = KERNELS.parent
    return library_wheel(platform, folder, project, (source / "README.md", source / "__init__.py"))


def library_wheel(platform: str, folder: Path, project: dict, texts: tuple[Path, Path]) -> Path:
    """As `build_wheel`; project: table of pyproject.toml, texts: README and the module's `__init__.py`."""
    build = load_build()
    library = build.build(platform)
    files = {
        f"{MODULE}/__init__.py": texts[1].read_bytes(),
        f"{MODULE}/{library.name}": library.read_bytes(),
        "licenses/LICENSE": (ROOT / "LICENSE").read_bytes(),
    }
    folder.mkdir(parents=True, exist_ok=True)
    tag = f"py3-none-{build.TARGETS[platform].tag}"
    return write_wheel(folder, core_metadata(project, texts[0].read_text()), tag, files)


def build_sdist(folder: Path) -> Path:
    """Write the source distribution into a folder; returns its path."""
    files = {str(path.relative_to(ROOT)): path.read_bytes() for pattern in SHARED for path in ROOT.glob(pattern)}
    settings = re.sub(r'^version = "0"$', f'version = "{version()}"', KERNELS.read_text(), flags=re.MULTILINE)
    readme = KERNELS.with_name("README.md")
    files |= {
        "pyproject.toml": settings.encode(),
        "README.md": readme.read_bytes(),
        "LICENSE": (ROOT / "LICENSE").read_bytes(),
    }
    folder.mkdir(parents=True, exist_ok=True)
    return write_sdist(folder, core_metadata(tomllib.loads(settings)["project"], readme.read_text()), files)
