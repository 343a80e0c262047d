# SPDX-License-Identifier: GPL-3.0-or-later
"""Networks by name: their weights files, checksums and inference.

A weights file states the kind of its network, which `register_kind` makes known. Systems registered with
`register_system` take the place of a network; `interfaces.System` says what they provide.
"""

import base64
import contextlib
import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..grids.working_cube import Cube
from ..models import weights_file
from ..models.abilities import SUNS_ALONE, Abilities, declare_kind
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.description import Volume
from ..scene.errors import SceneError
from .interfaces import Points, Predictor, System
from .provider import open_session


@dataclass(frozen=True)
class Kind:
    """How networks of a kind read volumes.

    read_points: their points around x, of the floats of a weights file. predictor: makes what reads a volume, from a
    network, a volume, its cube and its anisotropy. abilities: of these networks. deviations: standard deviations of
    their relative error by name, of those where it has been measured.
    """

    read_points: Callable[[np.ndarray], Points]
    predictor: Callable[["Network", Volume, Cube, float, CancelToken], Predictor]
    abilities: Abilities = SUNS_ALONE
    deviations: Mapping[str, float] = field(default_factory=dict)


#: Systems that `training` registers.
IN_TRAINING = ("reference", "rpnn")
# Points per call are padded to a multiple of this, which is a multiple of the vector width of any processor.
POINT_MULTIPLE = 16

_kinds: dict[str, Kind] = {}
_systems: dict[str, Callable[[], System]] = {}
_unlisted: set[str] = set()


def register_kind(name: str, kind: Kind) -> None:
    """Let weights files state a kind of networks."""
    _kinds[name] = kind
    declare_kind(name, kind.abilities)


def register_system(name: str, factory: Callable[[], System], listed: bool = True) -> None:
    """Let Settings.model name a system without a weights file, which knows suns alone; factory() makes it.

    listed: whether `available_models` names it.
    """
    _systems[name] = factory
    if not listed:
        _unlisted.add(name)


def available_models() -> list[str]:
    """Names that Settings.model accepts, except for systems that are not listed."""
    return sorted({path.stem for path in weights_file.WEIGHTS.glob("*.onnx")} | set(_systems) - _unlisted)


@dataclass
class Network:
    """A loaded network with the points around x that it was trained with; a `System`.

    session: of `open_session`. kind: that its file states. points: the network's stencil or lattice, of the file.
    configuration: of the training. checksum: SHA-256 of the file. provider: execution provider that runs it. warnings:
    why that is not the one asked for. lock: held while it runs, for providers that do not support concurrent calls.
    """

    session: Any
    kind: Kind
    points: Any
    configuration: dict[str, Any]
    checksum: str
    name: str
    provider: str = "CPU"
    warnings: list[str] = field(default_factory=list)
    lock: contextlib.AbstractContextManager[Any] = field(default_factory=contextlib.nullcontext)

    @property
    def deviation(self) -> float | None:
        """As of System."""
        return self.kind.deviations.get(self.name)

    @property
    def anisotropy_range(self) -> tuple[float, float]:
        """(lowest, highest) mean cosine in the training data."""
        low, high = self.configuration["anisotropy_range"]
        return low, high

    @property
    def sigma_hat_range(self) -> tuple[float, float]:
        """(lowest, highest) optical thickness of the working cube in the training data."""
        low, high = self.configuration["sigma_hat_range"]
        return low, high

    @property
    def albedo_range(self) -> tuple[float, float]:
        """(lowest, highest) albedo in the training data."""
        low, high = self.configuration.get("albedo_range", (0.0, 1.0))
        return low, high

    def predictor(
        self,
        volume: Volume,
        cube: Cube,
        anisotropy: float,
        cancel: CancelToken = NEVER,
    ) -> Predictor:
        """What reads one volume for this network. Raises Cancelled."""
        return self.kind.predictor(self, volume, cube, anisotropy, cancel)

    def run(self, **inputs: np.ndarray) -> np.ndarray:
        """Multiple-scattered radiance for a sun of irradiance 1: float32 (A, N), >= 0.

        inputs: arrays by name, converted to the types of the network's inputs; among them albedo (A,), and gamma (N,),
        or view (N,) where points share their gamma. The processor runs it on the calling thread lock, so that the
        result depends neither on the number of calling threads nor on the other points of a call.
        """
        count = len(inputs["view" if "view" in inputs else "gamma"])
        for model_input in self.session.get_inputs():
            value = inputs[model_input.name]
            value = np.asarray(value, np.int32 if "int32" in model_input.type else np.float32)
            # The remainder of a vector is rounded differently from a full vector.
            for axis in (axis for axis, size in enumerate(model_input.shape) if size in ("N", "V")):
                more = value.take(np.zeros(-value.shape[axis] % POINT_MULTIPLE, int), axis)
                value = np.concatenate([value, more], axis) if more.size else value
            inputs[model_input.name] = value
        with self.lock:
            return self.session.run(["radiance"], inputs)[0][:, :count]


def load_network(name: str, provider: str = "CPU") -> System:
    """A registered system, or the network in inference/weights/NAME.onnx.

    provider: of `provider.PROVIDERS`, for networks; if it is unavailable the processor runs the network, and a warning
    says so.

    Raises SceneError if the name is unknown, and if the file is damaged, does not match its checksum, does not match
    its points or refers to other files.
    """
    if name in _systems:
        return _systems[name]()
    available = ", ".join(available_models()) or "none"
    if name in IN_TRAINING:
        raise SceneError(
            f"{name} is not part of the extension: in the project's repository import training.{name} first; "
            f"available here: {available}"
        )
    if name not in available_models():
        raise SceneError(f"there is no network called {name!r}; available: {available}")
    return open_network(name, weights_file.read_weights(name), provider)


def open_network(name: str, content: bytes, provider: str = "CPU") -> Network:
    """The network in the content of a weights file; provider, errors: as for `load_network`."""
    try:
        opened = open_session(content, provider)
        session = opened.session
        metadata = session.get_modelmeta().custom_metadata_map
        stated = metadata["kind"]
        kind = _kinds[stated]
        points = kind.read_points(np.frombuffer(base64.b64decode(metadata["points"]), "<f4"))
        configuration = json.loads(metadata["configuration"])
        promised = metadata["points_sha256"]
        network = Network(
            session,
            kind,
            points,
            configuration,
            hashlib.sha256(content).hexdigest(),
            name,
            opened.provider,
            opened.warnings,
            opened.lock,
        )
        for low, high in (network.anisotropy_range, network.sigma_hat_range, network.albedo_range):
            if not low <= high:
                raise ValueError(f"its range from {low} to {high} is empty")
    except SceneError:
        raise
    except Exception as error:  # onnxruntime raises types of its own, all of which mean an unusable file
        raise SceneError(f"the weights of {name!r} cannot be read ({error}); reinstall the extension") from error
    if points.digest != promised:
        raise SceneError(f"the weights of {name!r} and their {stated} do not belong together; reinstall the extension")
    return network
