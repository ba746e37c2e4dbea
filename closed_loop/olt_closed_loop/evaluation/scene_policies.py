"""The policies `recorded` and `privileged`, which know the scene that they drive."""

from collections.abc import Callable

from olt_closed_loop.evaluation.evaluation import load_scene
from olt_closed_loop.privileged.driver import PrivilegedDriver
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.simulation.recorded_driver import RecordedDriver
from olt_closed_loop.simulation.scene_policy import ScenePolicy
from olt_toolkit.policy.contract import Policy


def load_recorded(argument: str | None) -> ScenePolicy:
    """The policy that drives a scene the way its recording went: log replay by control.

    Args:
        argument: the scene, where it cannot be told by who asks: a scene file, a recorded drive, CATEGORY:SEED, ...

    Raises:
        InputError: the scene cannot be read.
    """
    return _load(RecordedDriver.name, RecordedDriver, argument)


def load_privileged(argument: str | None) -> ScenePolicy:
    """The policy that sees everything (`privileged.driver`); see `load_recorded`."""
    return _load(PrivilegedDriver.name, PrivilegedDriver, argument)


def _load(name: str, make_driver: Callable[[Scene], Policy], argument: str | None) -> ScenePolicy:
    return ScenePolicy(name, make_driver, None if argument is None else load_scene(argument))
