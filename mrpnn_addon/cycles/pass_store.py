"""Finished passes of Cycles on disk, so that a second run continues the first."""

import hashlib
import json
import zipfile
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import List, Optional

import numpy as np

from ...inference.scene.sparse_grid import SparseGrid
from ..runtime.whole_file import whole_file

# Of what is stored, and of how it was rendered: another number finds nothing of the last.
FORMAT = 1

REFERENCE, CYCLES, DENOISED = "reference", "cycles", "cycles denoised"


@dataclass(frozen=True)
class Job:
    """One image to make. method: REFERENCE, CYCLES, DENOISED, or a network's name.
    samples: a pixel, or depth samples. seed: independent images of the same kind differ by it.
    """

    method: str
    samples: int
    seed: int = 0

    @property
    def by_cycles(self) -> bool:
        return self.method in (REFERENCE, CYCLES, DENOISED)

    @property
    def name(self) -> str:
        """For files."""
        return f"{self.method.replace(' ', '-')}-{self.samples}-{self.seed}"


@dataclass
class Pass:
    """image: float32 (H, W, 4), rows from the top, linear and premultiplied.
    seconds: wall clock; cpu_seconds: of all threads; once, once_cpu: of these, what another frame does not pay again.
    """

    image: np.ndarray
    seconds: float
    cpu_seconds: float
    once: float = 0.0
    once_cpu: float = 0.0
    warnings: List[str] = field(default_factory=list)


def scene_key(description, bounces: int, version: str) -> str:
    """Names what Cycles renders of a scene: a digest of its volumes, media, suns, camera and frame.

    description: a SceneDescription; version: Blender's.
    """
    digest = hashlib.sha256(repr((FORMAT, bounces, version, description.frame, description.environment)).encode())
    for volume, medium in description.volumes:
        digest.update(repr(volume.density.shape).encode())
        for grid in (volume.density, *volume.emission_channels()):
            for array in (grid.table, grid.values, grid.first) if isinstance(grid, SparseGrid) else (grid,):
                digest.update(np.ascontiguousarray(array))
        for array in (volume.world_from_index, medium.sigma_t, medium.albedo):
            digest.update(np.ascontiguousarray(array))
        if volume.emission is not None:
            digest.update(repr(volume.emission_power).encode())
            digest.update(repr(medium.emission).encode())
        digest.update(repr((medium.anisotropy, medium.phase)).encode())
    for sun in description.suns:
        digest.update(sun.direction.tobytes() + sun.irradiance.tobytes())
        for array in sun.spread or ():
            digest.update(np.ascontiguousarray(array))
    camera = asdict(description.camera)
    digest.update(camera.pop("world_matrix").tobytes())
    digest.update(repr(sorted(camera.items())).encode())
    return digest.hexdigest()[:16]


class PassStore:
    """A folder of passes of one scene."""

    def __init__(self, folder: Path):
        self.folder = Path(folder)

    def get(self, job: Job) -> Optional[Pass]:
        """The pass, or None where it was not made or its file is damaged."""
        try:
            with open(self._path(job), "rb") as stream, np.load(stream) as file:
                return Pass(file["image"], **json.loads(str(file["facts"])))
        except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile):
            return None

    def put(self, job: Job, done: Pass) -> None:
        """Keep a pass; its file appears complete. Raises OSError where it cannot be written."""
        self.folder.mkdir(parents=True, exist_ok=True)
        facts = {name: value for name, value in vars(done).items() if name != "image"}
        with whole_file(str(self._path(job))) as file:
            np.savez(file, image=done.image.astype(np.float32), facts=json.dumps(facts))

    def _path(self, job: Job) -> Path:
        return self.folder / f"{job.name}.npz"
