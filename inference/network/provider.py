# SPDX-License-Identifier: GPL-3.0-or-later
"""onnxruntime's execution providers: which one the user wants, and whether it is available and accurate."""

import contextlib
import threading
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..scene.errors import SceneError

# By the names in Settings. The shipped onnxruntime has CPU alone, and CoreML on macOS.
PROVIDERS = {
    "CPU": "CPUExecutionProvider",
    "CUDA": "CUDAExecutionProvider",
    "DIRECTML": "DmlExecutionProvider",
    "COREML": "CoreMLExecutionProvider",
    "OPENVINO": "OpenVINOExecutionProvider",
}
# Tolerated difference from the processor: root mean square over random inputs, relative to that of the processor.
TOLERANCE = 0.01
TRIAL_POINTS = 64


@dataclass
class OpenedSession:
    """An onnxruntime session.

    provider: key of PROVIDERS that runs it. warnings: why that is not the one asked for. lock: to be held while it
    runs.
    """

    session: Any
    provider: str
    warnings: list[str]
    lock: contextlib.AbstractContextManager[Any]


def open_session(content: bytes, provider: str) -> OpenedSession:
    """Open the network in an ONNX file's `content` with a provider.

    The processor takes the place of a provider that is unavailable or inaccurate. Raises SceneError for an unknown
    provider and if onnxruntime is missing, and onnxruntime's own errors.
    """
    if provider not in PROVIDERS:
        raise SceneError(f"there is no provider called {provider!r}; there are: {', '.join(PROVIDERS)}")
    try:
        import onnxruntime
    except ImportError as error:
        raise SceneError("onnxruntime cannot be imported; install it for this Python") from error
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
    found, expected = (one.run(["radiance"], inputs)[0].astype(np.float64) for one in (session, processor))
    error = np.sqrt(((found - expected) ** 2).mean() / (expected**2).mean())
    return "" if error <= TOLERANCE else f"its results differ from the processor's by {error:.1%}"
