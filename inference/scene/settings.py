"""How to render."""

from dataclasses import dataclass

from .errors import SceneError
from .optimizations import ALL


@dataclass
class Settings:
    """How to render.

    depth_samples: network evaluations along a camera ray that the medium hides, up to 512.
    model: name of the network (a file in inference/weights).
    seed: of the lookups' offsets; the same seed gives the same image.
    threads: worker threads, 0 for one a core; the image does not depend on it.
    memory_limit: bytes the render may use on top of its input; it is refused
        with a message where it would need more.
    multiple: whether to predict multiple scattering; without, the layer is darker.
    provider: of onnxruntime, that runs the network: one of `provider.PROVIDERS`.
    leave_out: names of `omissions.OPTIMIZATIONS`: what the picture does not need and is not done.
    """

    depth_samples: int = 4
    model: str = "mrpnn"
    seed: int = 0
    threads: int = 0
    memory_limit: int = 8 << 30
    multiple: bool = True
    provider: str = "CPU"
    leave_out: frozenset[str] = ALL

    def __post_init__(self):
        for name, least, most in (("depth samples", 1, 512), ("threads", 0, 1024), ("seed", 0, 2**63 - 1)):
            value = getattr(self, name.replace(" ", "_"))
            if not least <= value <= most or value != int(value):
                raise SceneError(f"{name} must be a whole number from {least} to {most}, not {value}")
        self.leave_out = frozenset(self.leave_out)
        unknown = sorted(self.leave_out - ALL)
        if unknown:
            raise SceneError(f"there is no {unknown[0]!r} to leave out; there are: {', '.join(sorted(ALL))}")
        if not self.memory_limit > 0:
            raise SceneError(f"the memory limit must be above 0, not {self.memory_limit}")
