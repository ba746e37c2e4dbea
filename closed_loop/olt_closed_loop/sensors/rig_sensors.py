"""The cameras of the policy's rig in a scene, as the simulation asks for them."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.sensors.ray_casting import SceneRenderer, render_rig
from olt_generator.poses import Array
from olt_toolkit.rigs.rig_files import pav_rig


def rig_sensors(scene: Scene) -> Callable[[tuple[str, ...], tuple[int, int], Array, int], NDArray[np.uint8]]:
    """What takes pictures with the nominal PhysicalAI-AV rig (`simulation.running_rollout.Sensors`).

    Every camera is the rig's own, the tele camera too: a vehicle in a scene has a real one. (In clips built from one
    front video the tele view is the 30-degree crop of the front view.)
    """
    renderer = SceneRenderer(scene)
    fitted_rig = lru_cache(maxsize=1)(lambda size: pav_rig().fitted(size[1], size[0]))

    def take_pictures(
        cameras: tuple[str, ...], size: tuple[int, int], T_world_rig: Array, time_us: int
    ) -> NDArray[np.uint8]:
        pictures = render_rig(renderer, fitted_rig(size), cameras, T_world_rig, time_us)
        return np.ascontiguousarray(np.stack([pictures[name].rgb for name in cameras]).transpose(0, 3, 1, 2))

    return take_pictures
