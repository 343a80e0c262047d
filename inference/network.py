"""One network on onnxruntime: file, checksum, provider and threads in one place."""

import base64
import hashlib
import json
import pathlib
from dataclasses import dataclass

import numpy as np

from .scene import SceneError
from .stencil import LOW_POINTS, POINTS, Stencil

WEIGHTS = pathlib.Path(__file__).parent / "weights"


def available_models():
    """Names that Settings.model accepts."""
    return sorted(path.stem for path in WEIGHTS.glob("*.onnx"))


@dataclass
class Network:
    """A loaded network with the stencil that it was trained with.

    stencil: the points inside the weights file. configuration: how it was trained.
    checksum: sha256 of the file.
    """

    session: object
    stencil: Stencil
    configuration: dict
    checksum: str
    name: str

    @property
    def anisotropy_range(self):
        """(lowest, highest) mean cosine seen in training."""
        return tuple(self.configuration["anisotropy_range"])

    @property
    def sigma_hat_range(self):
        """(lowest, highest) optical density of the cube seen in training."""
        return tuple(self.configuration["sigma_hat_range"])

    def multiple(self, features, anisotropy: float, gamma, albedos):
        """Multiple-scattered radiance for a sun of irradiance 1.

        features: float32 (3, N, 192); gamma: float32 (N,); albedos: (A,).
        Returns float32 (A, N), >= 0. Runs on the calling thread alone, so
        results do not depend on how many threads call.
        """
        inputs = {
            "features": features,
            "anisotropy": np.full(gamma.shape, anisotropy, np.float32),
            "gamma": gamma,
            "albedo": np.asarray(albedos, np.float32),
        }
        return self.session.run(["radiance"], inputs)[0]


def load_network(name: str) -> Network:
    """Load inference/weights/NAME.onnx.

    Raises SceneError where the name is unknown, the file is damaged, its
    stencil does not belong to it, or onnxruntime is missing.
    """
    if name not in available_models():
        raise SceneError(f"there is no network called {name!r}; available: {', '.join(available_models()) or 'none'}")
    content = (WEIGHTS / f"{name}.onnx").read_bytes()
    try:
        import onnxruntime
    except ImportError as error:
        raise SceneError(f"onnxruntime cannot be imported ({error}); reinstall the extension") from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    try:
        session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        metadata = session.get_modelmeta().custom_metadata_map
        points = np.frombuffer(base64.b64decode(metadata["stencil"]), "<f4")
        low = points[: 3 * LOW_POINTS].reshape(LOW_POINTS, 3)
        stencil = Stencil(low, points[3 * LOW_POINTS :].reshape(POINTS - LOW_POINTS))
        configuration = json.loads(metadata["configuration"])
        promised = metadata["stencil_sha256"]
    except Exception as error:  # onnxruntime raises types of its own, all meaning an unusable file
        raise SceneError(f"the weights of {name!r} cannot be read ({error}); reinstall the extension") from error
    if stencil.digest != promised:
        raise SceneError(f"the weights of {name!r} and their stencil do not belong together; reinstall the extension")
    return Network(session, stencil, configuration, hashlib.sha256(content).hexdigest(), name)
