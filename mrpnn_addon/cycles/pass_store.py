# SPDX-License-Identifier: GPL-3.0-or-later
"""Finished passes of Cycles on disk, so that a second run continues the first."""

import hashlib
import io
import json
import zipfile
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from ...inference.scene.sparse_grid import SparseGrid
from ..runtime.atomic_write import atomic_write, make_folder
from ..scene.reader import SceneDescription
from .choices import CHOICES

# Version of the files and of how they are rendered; files of other versions are ignored.
FORMAT = 2


@dataclass(frozen=True)
class Job:
    """One image to render. method: of CHOICES, or a network's name. samples: per pixel, or depth samples. seed:
    distinguishes independent images.
    """

    method: str
    samples: int
    seed: int = 0

    @property
    def by_cycles(self) -> bool:
        return self.method in CHOICES

    @property
    def name(self) -> str:
        """Base name of its files."""
        return f"{self.method.replace(' ', '-')}-{self.samples}-{self.seed}"


@dataclass
class Pass:
    """image: float32 (H, W, 4), rows from the top, linear and premultiplied. seconds: wall-clock. cpu_seconds: of all
    threads. once, once_cpu: the part of these that further frames do not repeat.
    """

    image: np.ndarray
    seconds: float
    cpu_seconds: float
    once: float = 0.0
    once_cpu: float = 0.0
    warnings: list[str] = field(default_factory=list)


def scene_key(description: SceneDescription, bounces: int, version: str) -> str:
    """Identifies what Cycles renders of a scene: a digest of its volumes, media, suns, camera and frame.

    description: a SceneDescription. version: Blender's.
    """
    digest = hashlib.sha256(repr((FORMAT, bounces, version, description.frame, description.environment)).encode())
    for volume, medium in description.volumes:
        digest.update(repr(volume.density.shape).encode())
        for grid in (volume.density, *volume.emission_channels(), *(medium.albedo if medium.varies else ())):
            for array in (grid.table, grid.values, grid.first) if isinstance(grid, SparseGrid) else (grid,):
                digest.update(np.ascontiguousarray(array).data)
        for array in (volume.world_from_index, medium.sigma_t, *(() if medium.varies else (medium.albedo,))):
            digest.update(np.ascontiguousarray(array).data)
        if volume.motion is not None:
            digest.update(volume.motion.world_matrices.tobytes())
        if volume.emission is not None:
            digest.update(repr(volume.emission_power).encode())
            digest.update(repr(medium.emission).encode())
        digest.update(repr((medium.anisotropy, medium.phase)).encode())
    for sun in description.suns:
        digest.update(sun.direction.tobytes() + sun.irradiance.tobytes())
        for array in sun.spread or ():
            digest.update(np.ascontiguousarray(array).data)
    for lamp in description.lamps:
        digest.update(repr(sorted((name, np.asarray(value).tolist()) for name, value in vars(lamp).items())).encode())
    for environment in description.environments:
        digest.update(environment.radiance.tobytes())
    camera = asdict(description.camera)
    digest.update(camera.pop("world_matrix").tobytes())
    digest.update(repr(sorted(camera.items())).encode())
    return digest.hexdigest()[:16]


class PassStore:
    """A folder of passes of one scene."""

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)

    def get(self, job: Job) -> Pass | None:
        """The pass; None where it does not exist or its file is damaged."""
        try:
            with open(self._path(job), "rb") as stream, np.load(stream) as file:
                return Pass(file["image"], **json.loads(str(file["facts"])))
        except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile):
            return None

    def put(self, job: Job, done: Pass) -> None:
        """Write a pass atomically. Raises OSError where it cannot be written."""
        make_folder(str(self.folder))
        facts = {name: value for name, value in vars(done).items() if name != "image"}
        content = io.BytesIO()
        # An archive that a full disk cuts off ends with a traceback on the console.
        np.savez(content, image=done.image.astype(np.float32), facts=json.dumps(facts))
        with atomic_write(str(self._path(job))) as file:
            file.write(content.getbuffer())

    def _path(self, job: Job) -> Path:
        return self.folder / f"{job.name}.npz"
