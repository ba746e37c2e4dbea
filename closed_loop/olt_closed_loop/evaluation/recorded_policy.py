"""The policy `recorded:SCENE`, which drives one scene the way its recording went: log replay by control."""

from olt_closed_loop.evaluation.evaluation import load_scene
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.simulation.recorded_driver import RecordedDriver
from olt_generator.errors import InputError
from olt_toolkit.policy.contract import Observation, PlannedTrajectory


class RecordedPolicy:
    """A `RecordedDriver` for each rollout of its scene."""

    name = RecordedDriver.name
    cameras: tuple[str, ...] = ()
    image_size: tuple[int, int] = (0, 0)

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.reset(0, scene.name)

    def reset(self, seed: int, scene: str) -> None:
        """Begin on the recording again. A rollout whose scene has no name is taken to be of this one.

        Raises:
            InputError: it is one of another scene.
        """
        if scene not in ("", self._scene.name):
            raise InputError(f"policy recorded: it follows the recording of {self._scene.name}, and drives {scene}")
        self._driver = RecordedDriver(self._scene)

    def plan(self, observation: Observation) -> PlannedTrajectory:
        """See `RecordedDriver.plan`."""
        return self._driver.plan(observation)


def load_recorded(argument: str | None) -> RecordedPolicy:
    """Build the policy from the scene after its name: a scene file, a recorded drive, or CATEGORY:SEED.

    Raises:
        InputError: no scene is given, or it cannot be read.
    """
    if not argument:
        raise InputError("policy recorded: give the scene whose recording it follows, such as recorded:cyclists:0")
    return RecordedPolicy(load_scene(argument))
