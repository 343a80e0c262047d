"""Networks by name: their files, checksums and calls.

What stands in for a network (`register_system`) has the attributes of Network that are listed there, and a method
`predictor`, whose result prepares predictions as StencilPredictor does.
"""

import base64
import contextlib
import hashlib
import json
import pathlib
from dataclasses import dataclass, field

import numpy as np

from ..runtime.cancellation import NEVER, CancelToken
from ..scene.errors import SceneError
from .lattice_predictor import LatticePredictor
from .provider import open_session
from .stencil_predictor import RayPredictor, StencilPredictor

WEIGHTS = pathlib.Path(__file__).parent.parent / "weights"
# What reads a volume for a network, by the kind that its weights file states.
KINDS = {"stencil": StencilPredictor, "ray": RayPredictor, "lattice": LatticePredictor}

# Points that any processor's vectors hold a whole number of times.
WHOLE = 16

_systems, _unlisted = {}, set()


def register_system(name: str, factory, listed: bool = True):
    """Let Settings.model name a system that has no weights file; factory() makes it.

    listed: whether `available_models` names it.
    """
    _systems[name] = factory
    if not listed:
        _unlisted.add(name)


def available_models():
    """Names that Settings.model accepts, but for those that are not listed."""
    return sorted({path.stem for path in WEIGHTS.glob("*.onnx")} | set(_systems) - _unlisted)


@dataclass
class Network:
    """A loaded network with the points around x that it was trained with.

    kind: of KINDS. points: its stencil or lattice, from the weights file. configuration: how it was
    trained. checksum: sha256 of the file. provider: of onnxruntime, that runs it; warnings: where it is not the wanted one.
    alone: held while it runs, where a provider takes one call at a time.
    """

    session: object
    kind: type
    points: object
    configuration: dict
    checksum: str
    name: str
    provider: str = "CPU"
    warnings: list[str] = field(default_factory=list)
    alone: object = field(default_factory=contextlib.nullcontext)

    @property
    def needs_ray_features(self) -> bool:
        """Whether `predict` needs the light along camera rays."""
        return self.kind.needs_ray_features

    @property
    def anisotropy_range(self):
        """(lowest, highest) mean cosine seen in training."""
        return tuple(self.configuration["anisotropy_range"])

    @property
    def sigma_hat_range(self):
        """(lowest, highest) optical density of the cube seen in training."""
        return tuple(self.configuration["sigma_hat_range"])

    @property
    def albedo_range(self):
        """(lowest, highest) albedo seen in training."""
        return tuple(self.configuration.get("albedo_range", (0.0, 1.0)))

    def predictor(self, volume, cube, anisotropy: float, cancel: CancelToken = NEVER):
        """What reads one volume for this network. Raises Cancelled."""
        return self.kind(self, volume, cube, anisotropy, cancel)

    def run(self, **inputs) -> np.ndarray:
        """Multiple-scattered radiance for a sun of irradiance 1: float32 (A, N), >= 0.

        inputs: arrays by name; int32 as they are, others converted to float32; albedo (A,) among them, and `gamma`, or
        where points share them `view`, (N,). On the processor it runs on the calling
        thread alone, so results do not depend on how many threads call, nor on which other points they come with.
        """
        count = len(inputs["view" if "view" in inputs else "gamma"])
        for model_input in self.session.get_inputs():
            value = inputs[model_input.name]
            value = np.asarray(value, np.int32 if "int32" in model_input.type else np.float32)
            # What is left over at the end of a vector is rounded otherwise than what fills one.
            for axis in (axis for axis, size in enumerate(model_input.shape) if size in ("N", "V")):
                more = value.take(np.zeros(-value.shape[axis] % WHOLE, int), axis)
                value = np.concatenate([value, more], axis) if more.size else value
            inputs[model_input.name] = value
        with self.alone:
            return self.session.run(["radiance"], inputs)[0][:, :count]


def load_network(name: str, provider: str = "CPU"):
    """A registered system, or the network in inference/weights/NAME.onnx.

    provider: of `provider.PROVIDERS`, for networks; where it cannot be had the processor runs them, and a warning says so.

    Raises SceneError where the name is unknown, the file is damaged or not the one that its checksum
    promises, its points do not belong to it, it refers to other files, or onnxruntime is missing.
    """
    if name in _systems:
        return _systems[name]()
    available = ", ".join(available_models()) or "none"
    if name == "reference":
        raise SceneError(
            "the path-traced reference is no part of the extension: in the project's repository import "
            f"training.reference first; available here: {available}"
        )
    if name not in available_models():
        raise SceneError(f"there is no network called {name!r}; available: {available}")
    content = _read_weights(name)
    try:
        opened = open_session(content, provider)
        session = opened.session
        metadata = session.get_modelmeta().custom_metadata_map
        kind = metadata["kind"]
        points = KINDS[kind].read_points(np.frombuffer(base64.b64decode(metadata["points"]), "<f4"))
        configuration = json.loads(metadata["configuration"])
        promised = metadata["points_sha256"]
        network = Network(session, KINDS[kind], points, configuration, hashlib.sha256(content).hexdigest(), name,
                          opened.provider, opened.warnings, opened.alone)
        for low, high in (network.anisotropy_range, network.sigma_hat_range, network.albedo_range):
            if not low <= high:
                raise ValueError(f"its range from {low} to {high} is empty")
    except SceneError:
        raise
    except Exception as error:  # onnxruntime raises types of its own, all meaning an unusable file
        raise SceneError(f"the weights of {name!r} cannot be read ({error}); reinstall the extension") from error
    if points.digest != promised:
        raise SceneError(f"the weights of {name!r} and their {kind} do not belong together; reinstall the extension")
    return network


def _read_weights(name: str) -> bytes:
    """A weights file that is what its checksum, NAME.sha256 beside it, promises. Raises SceneError where not."""
    try:
        content = (WEIGHTS / f"{name}.onnx").read_bytes()
        promised = (WEIGHTS / f"{name}.sha256").read_text().split()[0]
    except (OSError, IndexError, UnicodeDecodeError) as error:
        raise SceneError(f"the weights of {name!r} or their checksum cannot be read ({error}); "
                         "reinstall the extension") from None
    if hashlib.sha256(content).hexdigest() != promised:
        raise SceneError(f"the weights of {name!r} cannot be read: they are not what their checksum promises; "
                         "reinstall the extension")
    # The key under which ONNX names a file that holds a tensor's values.
    if b"location" in content:
        raise SceneError(f"the weights of {name!r} lie partly outside their file, which is refused")
    return content
