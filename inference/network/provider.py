"""onnxruntime's execution providers: which one runs a network, by the user's choice, and what is trusted to do so."""

import contextlib
import threading
from dataclasses import dataclass

import numpy as np

from ..scene.errors import SceneError

# By the names that settings have for them. The shipped onnxruntime has CPU alone, and CoreML on macOS.
PROVIDERS = {
    "CPU": "CPUExecutionProvider",
    "CUDA": "CUDAExecutionProvider",
    "DIRECTML": "DmlExecutionProvider",
    "COREML": "CoreMLExecutionProvider",
    "OPENVINO": "OpenVINOExecutionProvider",
}
# What another provider may differ from the processor by: root mean square over random inputs, relative to that of the
# processor's results.
TOLERANCE = 0.01
TRIAL_POINTS = 64


@dataclass
class Opened:
    """session: onnxruntime's. provider: of PROVIDERS, that runs it; warnings: why not the wanted one.
    alone: to be held while it runs.
    """

    session: object
    provider: str
    warnings: list[str]
    alone: object


def open_session(content: bytes, provider: str) -> Opened:
    """A session of the network in an ONNX file's `content`, by `provider` where that is there and gives what the
    processor gives, else by the processor.

    Raises SceneError for an unknown provider and where onnxruntime is missing, and onnxruntime's errors.
    """
    if provider not in PROVIDERS:
        raise SceneError(f"there is no provider called {provider!r}; there are: {', '.join(PROVIDERS)}")
    try:
        import onnxruntime
    except ImportError as error:
        raise SceneError(f"onnxruntime cannot be imported ({error}); reinstall the extension") from error
    processor = _session(onnxruntime, content, "CPU")
    if provider == "CPU":
        return Opened(processor, "CPU", [], contextlib.nullcontext())
    wanted = PROVIDERS[provider]
    if wanted not in onnxruntime.get_available_providers():
        problem = f"onnxruntime {onnxruntime.__version__} here has no {wanted}"
    else:
        try:
            session = _session(onnxruntime, content, provider)
            problem = _difference(session, processor) if session.get_providers()[0] == wanted else \
                f"onnxruntime cannot start {wanted} here, whose libraries or device are missing"
        except Exception as error:  # onnxruntime raises types of its own, as do drivers
            problem = f"{wanted} cannot run it ({error})"
    if not problem:
        # DirectML takes one call at a time, and no device gains by several.
        return Opened(session, provider, [], threading.Lock())
    warning = f"the network runs on the processor instead of {provider}: {problem}"
    return Opened(processor, "CPU", [warning], contextlib.nullcontext())


def _session(onnxruntime, content, provider):
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    # DirectML asks for this.
    options.enable_mem_pattern = provider != "DIRECTML"
    return onnxruntime.InferenceSession(content, options, providers=list(dict.fromkeys(
        [PROVIDERS[provider], PROVIDERS["CPU"]])))


def _difference(session, processor) -> str:
    """What a session gives otherwise than the processor for random inputs, in words; "" where it is the same."""
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
