"""The policy `recorded:SCENE`, which drives one scene the way its recording went (log replay by control)."""

from olt_closed_loop.evaluation.evaluation import load_scene
from olt_closed_loop.simulation.recorded_driver import RecordedDriver
from olt_generator.errors import InputError


def load_recorded(argument: str | None) -> RecordedDriver:
    """Build the policy from the scene after its name: a scene file, a recorded drive, or CATEGORY:SEED.

    Raises:
        InputError: no scene is given, or it cannot be read.
    """
    if not argument:
        raise InputError("policy recorded: give the scene whose recording it follows, such as recorded:cyclists:0")
    return RecordedDriver(load_scene(argument))
