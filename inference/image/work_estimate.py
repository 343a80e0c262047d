# SPDX-License-Identifier: GPL-3.0-or-later
"""How much work a render is: told to its Progress, and corrected as tiles and predictions are finished."""

from .camera_pass import estimate_march
from .context import ChannelPass, PreparedScene, RenderContext, Tile

# Share of the depth samples at which the network is evaluated, before any is known: pixels interpolate from their
# neighbours.
EVALUATED_SHARE = 0.4


class WorkEstimate:
    """Expects marched steps and depth samples by what a sparse grid of rays takes in the first channel pass.

    A job is one group of volumes in the light of one sun, or of all environments, in one set of colour channels; jobs
    are predicted tile by tile.
    """

    def __init__(self, context: RenderContext, scene: PreparedScene, tiles: list[Tile]):
        self._context, self._scene, self._tiles = context, scene, tiles
        # By the window of each tile.
        self._steps: dict[tuple[int, int, int, int], float] = {}
        self._samples: dict[tuple[int, int, int, int], float] = {}
        self._all_steps, self._all_samples, self._steps_marched, self._samples_predicted = 0.0, 0.0, 0.0, 0.0
        plan, progress = scene.plan, context.progress
        groups = sum(plan.predicts(g, channels) for channels in plan.channels for g in range(len(plan.groups)))
        suns = groups * len(plan.suns)
        # Environments are predicted together.
        self._jobs = suns + groups * bool(plan.environments)
        needs_fluence = scene.network is not None and scene.network.needs_ray_features
        progress.expect("transport", suns if needs_fluence else 0)
        # The lattices of a single sun serve every tile.
        progress.expect("lattices", suns * len(tiles) if len(plan.suns) > 1 else suns)

    def survey(self, channel_pass: ChannelPass) -> None:
        """Set what is expected of camera rays and of the network, once, where somebody wants to know."""
        if self._steps or not self._context.progress.wanted:
            return
        for tile in self._tiles:
            found = estimate_march(self._context, self._scene, channel_pass, tile.camera)
            self._steps[tile.camera.window], self._samples[tile.camera.window] = found
        self._all_steps = sum(self._steps.values()) * len(self._scene.plan.channels)
        self._all_samples = sum(self._samples.values()) * self._jobs
        self._context.progress.expect("march", self._all_steps)
        self._context.progress.expect("network", EVALUATED_SHARE * self._all_samples)

    def tile_marched(self, tile: Tile) -> None:
        """Correct what is expected of the other tiles' rays by what this tile's took."""
        self._steps_marched += self._steps.get(tile.camera.window, 0.0)
        self._correct("march", self._all_steps, self._steps_marched)

    def job_predicted(self, tile: Tile) -> None:
        """Correct what is expected of the other jobs by what this one took in a tile."""
        self._samples_predicted += self._samples.get(tile.camera.window, 0.0)
        self._correct("network", self._all_samples, self._samples_predicted)

    def _correct(self, stage: str, expected: float, finished: float) -> None:
        if finished > 0.0:
            progress = self._context.progress
            progress.expect(stage, progress.done(stage) * max(expected / finished, 1.0))
