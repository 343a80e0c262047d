# SPDX-License-Identifier: GPL-3.0-or-later
"""What models can predict, which plans depend on before any of them is loaded."""

import functools
import pathlib
from dataclasses import dataclass

from ..onnx.model_file import read_model
from ..scene.errors import SceneError
from . import weights_file

# Folder of the weights of networks for light from everywhere; each has the name of the network for suns beside it.
ENVIRONMENTS = "environment"


@dataclass(frozen=True)
class Abilities:
    """Of a model, or of a kind of networks.

    every_light: whether it predicts lamps and light from everywhere, not suns alone. light_bytes: bytes that it holds
    for each light.
    """

    every_light: bool = False
    light_bytes: int = 0


SUNS_ALONE = Abilities()
_kinds: dict[str, Abilities] = {}


def declare_kind(kind: str, abilities: Abilities) -> None:
    """Let plans know a kind of networks, as weights files name it."""
    _kinds[kind] = abilities


def abilities(model: str) -> Abilities:
    """Of a model by name; of one without a weights file, or with a damaged one, those of the least able."""
    try:
        state = (weights_file.WEIGHTS / f"{model}.onnx").stat()
        known = _kinds.get(_kind(weights_file.WEIGHTS, model, state.st_mtime_ns, state.st_size), SUNS_ALONE)
    except (OSError, SceneError, ValueError, KeyError):
        return SUNS_ALONE
    # Light from everywhere takes a second network.
    beside = (weights_file.WEIGHTS / ENVIRONMENTS / f"{model}.onnx").exists()
    return known if beside or not known.every_light else Abilities(light_bytes=known.light_bytes)


@functools.lru_cache
def _kind(folder: pathlib.Path, model: str, changed: int, size: int) -> str:
    """The kind that a weights file states; read again when it has changed."""
    return read_model(weights_file.read_weights(model)).metadata["kind"]
