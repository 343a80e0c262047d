# SPDX-License-Identifier: GPL-3.0-or-later
"""The ways in which Cycles renders a view, by name: as a reference, as a candidate, and as artists set it."""

from dataclasses import dataclass
from typing import Any

import bpy

REFERENCE = "reference"


@dataclass(frozen=True)
class Choice:
    """Settings of Cycles.

    bounces: most scattering events along a path, None for as many as the reference. clamp: of indirect light, 0 for
    none. null: by null scattering, which Blender 5.0 and later do unless volumes are *Biased*, rather than by ray
    marching, the only way of earlier versions.
    """

    bounces: int | None = None
    denoised: bool = False
    null: bool = False
    clamp: float = 0.0
    adaptive: bool = False
    guided: bool = False

    @property
    def words(self) -> list[str]:
        """What an artist would call it."""
        words = [] if self.bounces is None else [f"{self.bounces} volume bounces"]
        words += [f"clamped at {self.clamp:g}"] if self.clamp else []
        words += ["adaptive"] if self.adaptive else []
        words += ["guided"] if self.guided else []
        words += ["null scattering"] if self.null else []
        return words + (["denoised"] if self.denoised else [])

    @property
    def name(self) -> str:
        """Of the method, in figures and in names of files."""
        return f"cycles {', '.join(self.words)}".rstrip()

    def settings(self, bounces: int) -> dict[str, object]:
        """A scene's Cycles settings by name; before Blender 5.0 there is no `volume_biased`. bounces: where it has none
        of its own.
        """
        bounces = bounces if self.bounces is None else self.bounces
        found = {
            "max_bounces": max(bounces, 1),
            "volume_bounces": bounces,
            "use_denoising": self.denoised,
            "sample_clamp_indirect": self.clamp,
            "use_adaptive_sampling": self.adaptive,
            "use_guiding": self.guided,
            "volume_biased": not self.null,
        }
        return found | ({"denoiser": "OPENIMAGEDENOISE"} if self.denoised else {})


def has_null_scattering(scene: "bpy.types.Scene") -> bool:
    """Whether a scene's Cycles chooses between ray marching and null scattering."""
    return hasattr(scene.cycles, "volume_biased")


def usual(bounces: int, **others: Any) -> Choice:
    """As artists set it: few bounces, clamped and denoised."""
    return Choice(bounces, **{"denoised": True, "clamp": 10.0, **others})


#: Ladders of samples are measured of these: both ways through volumes, without and with denoising.
_LADDERS = [Choice(denoised=denoised, null=null) for null in (False, True) for denoised in (False, True)]
CYCLES, DENOISED, NULL, NULL_DENOISED = LADDERS = tuple(choice.name for choice in _LADDERS)
#: What artists really set, and samples per pixel; the last ones where Cycles has null scattering.
USUAL = (
    (usual(0), 32),
    (usual(4), 32),
    (usual(4), 128),
    (usual(12), 32),
    (usual(12), 128),
    (usual(12, adaptive=True), 128),
    (usual(12, guided=True), 32),
    (usual(0, null=True), 32),
    (usual(12, null=True), 32),
)
#: Every choice of a comparison, by the name of its method. References are marched: at equal time they have less noise.
CHOICES = {choice.name: choice for choice in (*_LADDERS, *(choice for choice, _ in USUAL))} | {REFERENCE: Choice()}
