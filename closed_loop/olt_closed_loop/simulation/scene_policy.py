"""Policies that must know which scene they drive, and how they come to know it."""

from collections.abc import Callable

from olt_closed_loop.scenes.scene import Scene
from olt_generator.errors import InputError
from olt_toolkit.policy.contract import Observation, PlannedTrajectory, Policy


class ScenePolicy:
    """A policy with a driver of its own for each rollout of a scene.

    The simulation tells it the scene (`for_scene`). Where nobody can, as where it is served to another simulator, the
    scene is given with it.
    """

    cameras: tuple[str, ...] = ()
    image_size: tuple[int, int] = (0, 0)

    def __init__(self, name: str, make_driver: Callable[[Scene], Policy], scene: Scene | None = None) -> None:
        self.name, self._make_driver, self._scene = name, make_driver, scene
        self._driver: Policy | None = None

    def for_scene(self, scene: Scene) -> "ScenePolicy":
        """The policy that knows a scene; one that was given a scene keeps that."""
        return ScenePolicy(self.name, self._make_driver, self._scene or scene)

    def reset(self, seed: int, scene: str) -> None:
        """Begin a rollout. One whose scene has no name is taken to be of the scene that the policy knows.

        Raises:
            InputError: it is of another scene, no scene is known, or the driver refuses it.
        """
        del seed
        if self._scene is None:
            raise InputError(f"policy {self.name} must know the scene; give it as in {self.name}:cyclists:0")
        if scene not in ("", self._scene.name):
            raise InputError(f"policy {self.name}: it knows the scene {self._scene.name}, and drives {scene}")
        self._driver = self._make_driver(self._scene)

    def plan(self, observation: Observation) -> PlannedTrajectory:
        """See `Policy.plan`.

        Raises:
            InputError: see `reset`, and what the driver refuses.
        """
        if self._driver is None:
            self.reset(observation.seed, "")
        assert self._driver is not None
        return self._driver.plan(observation)
