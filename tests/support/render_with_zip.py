# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders with the code and the wheels of this platform's zip, with Python alone, and compares the results.

    python tests/support/render_with_zip.py FOLDER

FOLDER holds build/mrpnn-*.zip. Unpacks the zip and its wheels into a temporary folder, as Blender does, and renders a
ball of fog twice: with the zip's onnxruntime, if it has one, and with the extension's own evaluation. Takes numpy from
this Python or installs it. For each platform's machine in the release's workflow; tests/package/test_zip.py runs it on
Linux.
"""

import os
import platform
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

MACHINES = {"amd64": "x64", "x86_64": "x64", "arm64": "arm64", "aarch64": "arm64"}
SYSTEMS = {"linux": "linux", "win32": "windows", "darwin": "macos"}
# How users' machines import the extension, without Blender: `inference` alone.
RENDER = """
import sys
import numpy as np
from inference import Camera, Medium, Settings, Sun, Volume, render

axis = (np.arange(32) + 0.5) / 32 - 0.5
x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
density = np.clip(4 - 10 * np.sqrt(x**2 + y**2 + z**2), 0, 1).astype(np.float32)
world_from_index = np.diag([1 / 32, 1 / 32, 1 / 32, 1.0])
world_from_index[:3, 3] = axis[0]
camera = np.eye(4)
camera[2, 3] = 2.5
layer = render(
    [(Volume(density, world_from_index), Medium(sigma_t=50.0, albedo=(0.9,) * 3, anisotropy=0.5))],
    [Sun(direction=(1.0, 1.0, 0.3), irradiance=3.0)],
    Camera(camera, resolution=(64, 36), fov=0.8),
    Settings(depth_samples=2),
)
np.save(sys.argv[1], layer.rgb)
print(layer.report.kernels, layer.report.provider)
"""


def extension_zip(folder: Path) -> Path:
    """The zip for this machine."""
    name = f"{SYSTEMS[sys.platform]}_{MACHINES[platform.machine().lower()]}"
    (path,) = folder.glob(f"build/mrpnn-*-{name}.zip")
    return path


def install(path: Path, folder: Path) -> list[str]:
    """Unpack a zip into folder/extension, and the wheels that fit this Python into folder/site; returns their names."""
    python = "cp{}{}".format(*sys.version_info[:2])
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder / "extension")
    wheels = sorted((folder / "extension" / "wheels").glob("*.whl"))
    fitting = [wheel for wheel in wheels if wheel.name.split("-")[2] in ("py3", python)]
    for wheel in fitting:
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(folder / "site")
    return [wheel.name.split("-")[0] for wheel in fitting]


def main(folder: Path) -> int:
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as made:
        work = Path(made)
        packages = install(extension_zip(folder), work)
        try:
            import numpy
        except ImportError:
            command = ["-m", "pip", "install", "--quiet", "--target", work / "site", "numpy"]
            subprocess.run([sys.executable, *command], check=True)
            sys.path.append(str(work / "site"))
            import numpy
        paths = [work / "extension", work / "site", Path(numpy.__file__).parents[1]]
        pictures = {}
        for provider in ("CPU", "built-in") if "onnxruntime" in packages else ("built-in",):
            if provider == "built-in":
                # A package of that name that does not load.
                (work / "without" / "onnxruntime").mkdir(parents=True)
                (work / "without" / "onnxruntime" / "__init__.py").write_text("raise ImportError('none')")
                paths.insert(0, work / "without")
            target = work / f"{provider}.npy"
            run = subprocess.run(
                [sys.executable, "-c", RENDER, target],
                capture_output=True,
                text=True,
                cwd=work,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, paths))},
            )
            print(run.stdout, run.stderr, sep="")
            if run.returncode or provider not in run.stdout:
                return 1
            pictures[provider] = numpy.load(target)
        first, *others = pictures.values()
        if not first.max() > 0.0:
            print("the picture is black")
            return 1
        worst = max((abs(other - first).max() / first.max() for other in others), default=0.0)
        print(f"largest difference {worst:.1e}, {', '.join(packages)}")
        return int(worst > 1e-4)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
