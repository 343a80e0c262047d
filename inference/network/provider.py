# SPDX-License-Identifier: GPL-3.0-or-later
"""What runs networks: one of onnxruntime's execution providers, or this project's own evaluation without it."""

import contextlib
import hashlib
import importlib
import json
import re
import threading
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Self

import numpy as np

from ..models.weights_file import read_weights
from ..onnx.session import Session
from ..scene.errors import SceneError

# By the names in Settings. The shipped onnxruntime has CPU alone, and CoreML on macOS.
PROVIDERS = {
    "CPU": "CPUExecutionProvider",
    "CUDA": "CUDAExecutionProvider",
    "DIRECTML": "DmlExecutionProvider",
    "COREML": "CoreMLExecutionProvider",
    "OPENVINO": "OpenVINOExecutionProvider",
}
#: What runs networks where there is no onnxruntime, as reports name it.
BUILT_IN = "built-in"
#: The oldest onnxruntime that runs the networks' ONNX opset 17.
OLDEST = (1, 12)
# Tolerated difference from the processor: root mean square over random inputs, relative to that of the processor.
TOLERANCE = 0.01
TRIAL_POINTS = 64


@dataclass
class OpenedSession:
    """A network that is ready to run.

    session: of onnxruntime, or `onnx.session.Session`. provider: key of PROVIDERS that runs it, or BUILT_IN. warnings:
    why that is not the one asked for. lock: to be held while it runs.
    """

    session: Any
    provider: str
    warnings: list[str]
    lock: contextlib.AbstractContextManager[Any]


def open_session(content: bytes, provider: str) -> OpenedSession:
    """Open the network in an ONNX file's `content` with a provider.

    The processor takes the place of a provider that is unavailable or inaccurate, and the built-in evaluation that of
    onnxruntime where it is missing. Raises SceneError for an unknown provider, MalformedFile, and onnxruntime's own
    errors.
    """
    if provider not in PROVIDERS:
        raise SceneError(f"there is no provider called {provider!r}; there are: {', '.join(PROVIDERS)}")
    onnxruntime = load_onnxruntime()
    if onnxruntime is None:
        said = f"the network runs on the processor instead of {provider}: there is no onnxruntime that loads"
        return OpenedSession(Session(content), BUILT_IN, [said] if provider != "CPU" else [], contextlib.nullcontext())
    processor = _session(onnxruntime, content, "CPU")
    if provider == "CPU":
        return OpenedSession(processor, "CPU", [], contextlib.nullcontext())
    wanted = PROVIDERS[provider]
    if wanted not in onnxruntime.get_available_providers():
        problem = f"onnxruntime {onnxruntime.__version__} here has no {wanted}"
    else:
        try:
            session = _session(onnxruntime, content, provider)
            problem = (
                _difference(session, processor)
                if session.get_providers()[0] == wanted
                else f"onnxruntime cannot start {wanted} here, whose libraries or device are missing"
            )
        except Exception as error:  # onnxruntime raises types of its own, and so do drivers
            problem = f"{wanted} cannot run it ({error})"
    if not problem:
        # DirectML does not support concurrent calls, and no device gains by them.
        return OpenedSession(session, provider, [], threading.Lock())
    warning = f"the network runs on the processor instead of {provider}: {problem}"
    return OpenedSession(processor, "CPU", [warning], contextlib.nullcontext())


def load_onnxruntime() -> ModuleType | None:
    """The module onnxruntime; None where it is missing, cannot be loaded or is too old."""
    try:
        module = importlib.import_module("onnxruntime")
    except Exception:  # A package may raise anything.
        return None
    # A folder of that name is a module, too.
    return module if hasattr(module, "InferenceSession") and is_recent(getattr(module, "__version__", "0")) else None


def is_recent(version: str) -> bool:
    """Whether an onnxruntime of a version runs the networks."""
    return tuple(map(int, re.findall(r"\d+", version)[:2])) >= OLDEST


def _session(onnxruntime: Any, content: bytes, provider: str) -> Any:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    # DirectML does not support memory patterns.
    options.enable_mem_pattern = provider != "DIRECTML"
    return onnxruntime.InferenceSession(
        content, options, providers=list(dict.fromkeys([PROVIDERS[provider], PROVIDERS["CPU"]]))
    )


def _difference(session: Any, processor: Any) -> str:
    """How the results of a session differ from those of the processor for random inputs, in words; "" if they agree."""
    random = np.random.default_rng(0)
    inputs = {}
    for asked in processor.get_inputs():
        shape = [size if isinstance(size, int) else TRIAL_POINTS for size in asked.shape]
        inputs[asked.name] = random.random(shape, np.float32)
        if "int32" in asked.type:
            inputs[asked.name] = np.arange(TRIAL_POINTS, dtype=np.int32)
    results, expected = (runner.run(["radiance"], inputs)[0].astype(np.float64) for runner in (session, processor))
    error = np.sqrt(((results - expected) ** 2).mean() / (expected**2).mean())
    return "" if error <= TOLERANCE else f"its results differ from the processor's by {error:.1%}"


@dataclass
class SmallNetwork:
    """A loaded network beside one for suns. session: of `open_session`. checksum: of its file. lock: while it runs."""

    session: Any
    configuration: dict[str, Any]
    checksum: str
    lock: contextlib.AbstractContextManager[Any]

    @classmethod
    def load(cls, folder: str, model: str, provider: str = "CPU") -> Self:
        """From a folder of weights; provider: of PROVIDERS. Raises SceneError where the file is missing or damaged."""
        content = read_weights(f"{folder}/{model}")
        try:
            opened = open_session(content, provider)
            configuration = json.loads(opened.session.get_modelmeta().custom_metadata_map["configuration"])
        except SceneError:
            raise
        except Exception as error:  # onnxruntime raises types of its own, all of which mean an unusable file
            raise SceneError(f"the weights of {model!r} cannot be read ({error}); reinstall the extension") from error
        return cls(opened.session, configuration, hashlib.sha256(content).hexdigest(), opened.lock)
