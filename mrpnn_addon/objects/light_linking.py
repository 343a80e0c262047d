# SPDX-License-Identifier: GPL-3.0-or-later
"""Which volumes and surfaces each light lights: light linking and ray visibility."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import bpy

from ...inference.scene import Sun
from .lights import Lamp
from .surfaces import OpaqueMesh
from .visibility import VisibleObject

Light = Sun | Lamp | OpaqueMesh


@dataclass
class LightLinks:
    """What a scene shows of lights, volumes and surfaces, while it is read.

    Objects are known by the addresses of the originals, which hold while Blender evaluates a frame.
    """

    _receivers: list["_Receiver"] = field(default_factory=list)
    _lights: list["_LinkedLight"] = field(default_factory=list)

    def add_volume(self, shown: VisibleObject, name: str) -> None:
        """A volume, as `inference` knows it."""
        self._receivers.append(_Receiver(name, _addresses(shown), True))

    def add_surface(self, shown: VisibleObject, name: str) -> None:
        """A surface, as `inference` knows it."""
        self._receivers.append(_Receiver(name, _addresses(shown), False))

    def add_light(self, shown: VisibleObject, lights: Sequence[Light]) -> None:
        """The lights that a lamp or a mesh is."""
        collection = shown.object.light_linking.receiver_collection
        states = {} if collection is None else dict(_states(collection))
        of_volumes, of_surfaces = shown.visible_to("volume_scatter"), shown.visible_to("diffuse")
        if states or not (of_volumes and of_surfaces):
            self._lights += [_LinkedLight(light, states, of_volumes, of_surfaces) for light in lights]

    def link(self) -> list[Light]:
        """Set the receivers of the lights that do not light everything; returns those that light nothing."""
        for one in self._lights:
            one.light.receivers = frozenset(receiver.name for receiver in self._receivers if one.lights(receiver))
        return [one.light for one in self._lights if not one.light.receivers]


@dataclass(frozen=True)
class _Receiver:
    """addresses: of the object that instances it, and of its own."""

    name: str
    addresses: tuple[int, int]
    is_volume: bool


@dataclass(frozen=True)
class _LinkedLight:
    """states: whether an object that the light is linked to, by address, is included."""

    light: Light
    states: dict[int, bool]
    of_volumes: bool
    of_surfaces: bool

    def lights(self, receiver: _Receiver) -> bool:
        """As Cycles: links of the object that instances come first; without included ones, all are."""
        if not (self.of_volumes if receiver.is_volume else self.of_surfaces):
            return False
        state = next((self.states[address] for address in receiver.addresses if address in self.states), None)
        return not any(self.states.values()) if state is None else state


def _addresses(shown: VisibleObject) -> tuple[int, int]:
    return shown.source.as_pointer(), shown.object.original.as_pointer()


def _states(collection: "bpy.types.Collection") -> Iterator[tuple[int, bool]]:
    """Addresses of a collection's objects, and whether they are included; excluded ones last.

    The state of a collection within it is that of everything in it.
    """
    found = []
    for shown, link in zip(collection.objects, collection.collection_objects):
        found.append((shown.original.as_pointer(), link.light_linking.link_state == "INCLUDE"))
    for child, child_link in zip(collection.children, collection.collection_children):
        included = child_link.light_linking.link_state == "INCLUDE"
        found += [(shown.original.as_pointer(), included) for shown in child.all_objects]
    yield from sorted(found, key=lambda one: not one[1])
