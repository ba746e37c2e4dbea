"""The drives that a specification of the synthetic world names, told without inventing more of a scene than it must.

A category of `olt_closed_loop.scenes.procedural` gives one drive for each scene seed, and all of its images are shown.
`training/` and the name of a group or an event of `olt_closed_loop.suite.training` gives one too, or its legs where
drives are disturbed; later images than samples show are not filmed.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.scenes.conditions import Conditions
from olt_closed_loop.scenes.driving import SAMPLE_US
from olt_closed_loop.scenes.procedural import CATEGORIES, DURATION_US, generate_scene
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.sensors.ray_casting import SceneRenderer
from olt_closed_loop.sensors.recorder import image_times
from olt_closed_loop.suite.disturbances import Disturbance
from olt_closed_loop.suite.training import (
    GROUPS,
    PREFIX,
    TRAINING_EVENTS,
    Leg,
    factors_of_leg,
    find_legs,
    make_training_scene,
    name_in_group,
)
from olt_generator import Trajectory

NAMES: tuple[str, ...] = (*CATEGORIES, *(f"{PREFIX}{name}" for name in (*GROUPS, *TRAINING_EVENTS)))
"""All that a specification can ask for."""
_generate_scene = lru_cache(maxsize=8)(generate_scene)
_make_training_scene = lru_cache(maxsize=8)(make_training_scene)


@dataclass(frozen=True)
class SceneDrive:
    """One drive of a scene, or a leg of one.

    Attributes:
        key: of the drive in its data set.
        world: key of the scene, which drives of other legs share.
        name, seed: category or event, and seed of the scene.
        shown_us: times in the scene between which its images lie.
        motion_us: how long its motion is known, in the scene.
        leg: which leg it is; None for a procedural scene.
        disturbance: of the drive; None where it is not disturbed.
    """

    key: str
    world: str
    name: str
    seed: int
    shown_us: tuple[int, int]
    motion_us: int
    leg: Leg | None = None
    disturbance: Disturbance | None = None

    def image_times(self, frame_rate: float) -> NDArray[np.int64]:
        """Times (n,) of its images in the scene, microseconds."""
        times = image_times(self.motion_us, frame_rate)
        return times[(times >= self.shown_us[0]) & (times <= self.shown_us[1])]

    @property
    def category(self) -> str:
        """Long-tail category, or nominal."""
        return self.scene().category if self.leg is None else TRAINING_EVENTS[self.name].category

    @property
    def factors(self) -> tuple[str, ...]:
        """Scene factors."""
        return self.scene().factors if self.leg is None else factors_of_leg(self.name, self.leg)

    def renderer(self, conditions: Conditions) -> SceneRenderer:
        """What takes its pictures: the same for all legs of a scene, since who films is not to be seen."""
        return _renderer(self.name, self.seed, self.leg is not None, conditions)

    def scene(self) -> Scene:
        """The scene with the drive as its recording."""
        if self.leg is None:
            scene = _generate_scene(self.name, self.seed)
        else:
            scene = _make_training_scene(self.name, self.seed, self.disturbance, self.leg.number)
        shown = scene.ego.timestamps_us <= self.motion_us
        return replace(scene, ego=Trajectory(scene.ego.timestamps_us[shown], scene.ego.T_world_rig[shown]))


@lru_cache(maxsize=2)
def _renderer(name: str, seed: int, trains: bool, conditions: Conditions) -> SceneRenderer:
    return SceneRenderer(_make_training_scene(name, seed) if trains else _generate_scene(name, seed), conditions)


def find_drives(
    name: str, seed: int, until_us: int | None = None, disturbance: Disturbance | None = None
) -> Iterator[SceneDrive]:
    """The drives of one of NAMES and a seed, each up to a time (microseconds) where one is given."""
    if not name.startswith(PREFIX):
        key, end_us = f"{name}_{seed:06d}", min(until_us or DURATION_US, DURATION_US)
        end_us -= end_us % SAMPLE_US
        yield SceneDrive(key, key, name, seed, (0, end_us), end_us)
        return
    group = name.removeprefix(PREFIX)
    event = name_in_group(group, seed) if group in GROUPS else group
    world = f"training_{event}_{seed:06d}"
    for leg in find_legs(event, seed, disturbance):
        last_us, end_us = (min(each, until_us or each) for each in (leg.last_us, leg.end_us))
        if leg.first_us < last_us:
            key = world if disturbance is None else f"{world}_leg_{leg.number}"
            yield SceneDrive(key, world, event, seed, (leg.first_us, last_us), end_us, leg, disturbance)
