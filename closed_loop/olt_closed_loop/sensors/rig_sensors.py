"""The cameras of the policy's rig in a scene, as the simulation asks for them."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.sensors.ray_casting import SceneRenderer
from olt_generator.poses import Array
from olt_toolkit.rigs.rig import Rig
from olt_toolkit.rigs.rig_files import pav_rig


class RigSensors:
    """Renders the nominal PhysicalAI-AV rig.

    Every camera is the rig's own, the tele camera too: a vehicle in a scene has a real one. (In clips built from one
    front video the tele view is the 30-degree crop of the front view.)
    """

    def __init__(self, scene: Scene) -> None:
        self._renderer = SceneRenderer(scene)

    def render_rig(
        self, cameras: tuple[str, ...], size: tuple[int, int], T_world_rig: Array, time_us: int
    ) -> NDArray[np.uint8]:
        """See `simulation.closed_loop.Sensors`."""
        height, width = size
        rig = _fitted_rig(width, height)
        views = [
            self._renderer.render(rig[name].camera, T_world_rig @ rig[name].T_rig_camera, time_us).rgb
            for name in cameras
        ]
        return np.ascontiguousarray(np.stack(views).transpose(0, 3, 1, 2))


@lru_cache(maxsize=4)
def _fitted_rig(width: int, height: int) -> Rig:
    return pav_rig().fitted(width, height)
