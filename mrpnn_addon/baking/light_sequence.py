# SPDX-License-Identifier: GPL-3.0-or-later
"""The light of consecutive frames in a folder, of which an index knows what each file was baked from; calls no bpy."""

import json
import os
import secrets
import shutil
from dataclasses import replace
from typing import Any

import numpy as np

from ...inference.baking.directional_factor import SMOOTH, BakedView, DirectionalFactor, Lobe, NodeGrid
from ..runtime.atomic_write import make_folder
from ..runtime.json_file import write_json
from .bake_job import BakedScene, BakedVolume, BakeTarget, file_name

INDEX = "baked_light.json"
# Of the index's contents.
VERSION = 1


class LightSequence:
    """Frames of light that are baked one after the other; those whose content is in the folder already are not.

    target: for `bake_scene`. frames: so far.
    """

    def __init__(self, folder: str) -> None:
        self.folder, self.frames = folder, list[BakedScene]()
        # Blender caches files by path: every sequence has names of its own.
        self._token = secrets.token_hex(4)
        self._known = _read_index(folder)

    @property
    def target(self) -> BakeTarget:
        """Where the next frame's light goes."""
        return BakeTarget(self.folder, known=dict(self._known))

    def add(self, baked: BakedScene) -> BakedScene:
        """Take the light of one frame; gives it with the names of its files.

        Raises OSError and SceneError where these cannot be written.
        """
        volumes = [self._named(one, baked.frame) for one in baked.volumes]
        named = replace(baked, volumes=volumes)
        self.frames.append(named)
        self._known.update((one.key, one) for one in volumes)
        if volumes:
            _write_index(self.folder, self._known)
        return named

    def _named(self, one: BakedVolume, frame: int) -> BakedVolume:
        """A volume's light in the file of this sequence and frame; a file that is known stays."""
        path = os.path.join(self.folder, f"{file_name(one.name)}-{self._token}_{frame:04d}.vdb")
        make_folder(self.folder)
        if one.key not in self._known:
            os.replace(one.path, path)
        else:
            try:
                os.link(one.path, path)
            except OSError:  # The folder's file system has no links.
                shutil.copyfile(one.path, path)
        return replace(one, path=path)


def _write_index(folder: str, known: dict[str, BakedVolume]) -> None:
    # Other machines of a farm may have written meanwhile.
    known = _read_index(folder) | known
    lights = {
        key: {"file": os.path.basename(one.path), "scale": one.scale, "directional": _plain(one.directional)}
        for key, one in known.items()
    }
    write_json(os.path.join(folder, INDEX), {"version": VERSION, "lights": lights})


def _read_index(folder: str) -> dict[str, BakedVolume]:
    """What a folder's index knows, by key; nothing where there is none that can be read."""
    try:
        with open(os.path.join(folder, INDEX), encoding="utf-8") as file:
            content = json.load(file)
        lights = content["lights"] if content["version"] == VERSION else {}
        found = {key: _volume(folder, key, light) for key, light in lights.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}
    return {key: one for key, one in found.items() if os.path.isfile(one.path)}


def _volume(folder: str, key: str, light: dict) -> BakedVolume:
    path = os.path.join(folder, os.path.basename(light["file"]))
    return BakedVolume("", key, path, float(light["scale"]), _factor(light["directional"]))


def _plain(factor: DirectionalFactor | None) -> dict | None:
    """What a material needs of a factor, for JSON."""
    if factor is None:
        return None
    view, lobe = factor.view, factor.lobe
    return {
        "position": _list(view.position),
        "direction": _list(view.direction),
        "up": _list(view.up),
        "lights": _list(lobe.directions),
        "weights": _list(lobe.weights),
        "anisotropy": float(lobe.anisotropy),
        "sharpness": float(factor.sharpness),
        "anchors": factor.anchors.values.shape[3],
        "colours": factor.colours is not None,
    }


def _factor(plain: dict | None) -> DirectionalFactor | None:
    """The inverse of `_plain`."""
    if plain is None:
        return None
    position, direction, up = (_array(plain[name]) for name in ("position", "direction", "up"))
    lobe = Lobe(np.array(plain["lights"], float).reshape(-1, 3), np.array(plain["weights"], float), plain["anisotropy"])
    view = BakedView(position=position, direction=direction, up=up)
    colours = _no_nodes(9) if plain["colours"] else None
    return DirectionalFactor(
        smooth=_no_nodes(SMOOTH),
        anchors=_no_nodes(plain["anchors"]),
        colours=colours,
        lobe=lobe,
        view=view,
        sharpness=float(plain["sharpness"]),
    )


def _no_nodes(coefficients: int) -> NodeGrid:
    return NodeGrid(np.zeros((0, 0, 0, coefficients), np.float32), np.eye(4))


def _list(vector: np.ndarray | None) -> list | None:
    return None if vector is None else np.asarray(vector, float).tolist()


def _array(values: Any) -> np.ndarray | None:
    return None if values is None else np.array(values, float)
