"""The cameras of the policy's rig in a scene, as the simulation asks for them."""

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.sensors.ray_casting import SceneRenderer, render_rig
from olt_generator.poses import Array
from olt_toolkit.rigs.rig_files import pav_rig


class RigSensors:
    """Renders the nominal PhysicalAI-AV rig.

    Every camera is the rig's own, the tele camera too: a vehicle in a scene has a real one. (In clips built from one
    front video the tele view is the 30-degree crop of the front view.)
    """

    def __init__(self, scene: Scene) -> None:
        self._renderer = SceneRenderer(scene)
        self._rig, self._size = pav_rig(), (0, 0)

    def render_rig(
        self, cameras: tuple[str, ...], size: tuple[int, int], T_world_rig: Array, time_us: int
    ) -> NDArray[np.uint8]:
        """Images (cameras, 3, H, W) uint8 of size (H, W), the rig being at pose (4, 4)."""
        if size != self._size:
            height, width = size
            self._rig, self._size = pav_rig().fitted(width, height), size
        pictures = render_rig(self._renderer, self._rig, cameras, T_world_rig, time_us)
        return np.ascontiguousarray(np.stack([pictures[name].rgb for name in cameras]).transpose(0, 3, 1, 2))
