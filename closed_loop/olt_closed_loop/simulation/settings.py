"""How scenes are driven, and when."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.control.tracking import ControlSettings
from olt_closed_loop.rollouts.rollout import Traffic
from olt_closed_loop.scenes.conditions import CLEAR_DAY, Conditions
from olt_closed_loop.scenes.scene import Scene
from olt_closed_loop.simulation.camera_faults import CameraFault
from olt_closed_loop.simulation.policy_hosts import PolicyLimits
from olt_closed_loop.vehicle.integrators import DEFAULT_METHOD, Method
from olt_closed_loop.vehicle.parameters import VehicleParameters, vehicle_with_tyres
from olt_generator.errors import InputError
from olt_toolkit.policy.contract import IMAGE_FRAMES, STEP_US

VehicleKind = Literal["kinematic", "tyres"]

_LONGEST_INTERVAL_US = 3_000_000


@dataclass(frozen=True)
class SimulationSettings:
    """How a scene is driven.

    Attributes:
        warm_up_us: how long the recording drives, a multiple of 0.1 s and at least the 0.3 s that the pictures of the
            first plan reach back.
        duration_us: how long the rollout lasts, warm-up included; it ends earlier where the recording does.
        planner_delay_us: how long after it was asked for a plan is in force, a multiple of 0.1 s; the first is asked
            for within the warm-up.
        plan_interval_us: how long from asking for a plan until the next is asked for, a multiple of 0.1 s.
        traffic: "recorded", or "idm" for vehicles that brake for the ego (`simulation.reactive_agents`).
        vehicle: "kinematic", or "tyres" for tyres that slip and saturate (`vehicle.parameters`).
        integrator: how the vehicle is integrated (`vehicle.integrators`).
        control: how plans are tracked (`control.tracking`).
        skip: whether what cannot change the result is left out; the result is the same without, only slower.
        conditions: light and weather of the pictures (`scenes.conditions`).
        camera_faults: what is wrong with the cameras (`simulation.camera_faults`).
        limits: where the policy runs, what it may take, and when it has failed (`simulation.policy_hosts`).
    """

    warm_up_us: int = 1_700_000
    duration_us: int = 20_000_000
    planner_delay_us: int = 0
    plan_interval_us: int = STEP_US
    traffic: Traffic = "recorded"
    vehicle: VehicleKind = "kinematic"
    integrator: Method = DEFAULT_METHOD
    control: ControlSettings = field(default_factory=ControlSettings)
    skip: bool = True
    conditions: Conditions = CLEAR_DAY
    camera_faults: tuple[CameraFault, ...] = ()
    limits: PolicyLimits = field(default_factory=PolicyLimits)

    def __post_init__(self) -> None:
        pictures_us = (IMAGE_FRAMES - 1) * STEP_US
        if self.warm_up_us % STEP_US or self.warm_up_us < pictures_us:
            raise InputError(f"warm-up of {self.warm_up_us} us: give a multiple of 100000 us, 300000 us or more")
        longest_us = self.warm_up_us - pictures_us
        if self.planner_delay_us % STEP_US or not 0 <= self.planner_delay_us <= longest_us:
            raise InputError(
                f"planner delay of {self.planner_delay_us} us: give a multiple of 100000 us, at most {longest_us} us "
                "with this warm-up"
            )
        if self.plan_interval_us % STEP_US or not STEP_US <= self.plan_interval_us <= _LONGEST_INTERVAL_US:
            raise InputError(
                f"plans every {self.plan_interval_us} us: give a multiple of {STEP_US} us, at most "
                f"{_LONGEST_INTERVAL_US} us, so that the plan in force reaches beyond the next"
            )

    def vehicle_of(self, scene: Scene) -> VehicleParameters:
        """The vehicle that drives a scene."""
        if self.vehicle == "tyres":
            return vehicle_with_tyres(scene.vehicle)
        return VehicleParameters.from_dimensions(scene.vehicle)

    @property
    def handover(self) -> int:
        """The step at which the policy takes over."""
        return self.warm_up_us // STEP_US

    @property
    def plan_interval(self) -> int:
        """Steps from asking for a plan until the next is asked for."""
        return self.plan_interval_us // STEP_US

    @property
    def planner_delay(self) -> int:
        """Steps from asking for a plan until it is in force."""
        return self.planner_delay_us // STEP_US


def step_times(scene: Scene, settings: SimulationSettings) -> NDArray[np.int64]:
    """Times (n,) of the rollout's states, microseconds.

    Raises:
        InputError: the recording ends before the policy could drive one step.
    """
    start, end = int(scene.ego.timestamps_us[0]), int(scene.ego.timestamps_us[-1])
    steps = min(settings.duration_us, end - start) // STEP_US
    if steps * STEP_US <= settings.warm_up_us:
        raise InputError(
            f"scene {scene.name}: a drive of {steps * STEP_US * 1e-6:.1f} s leaves nothing after the warm-up of "
            f"{settings.warm_up_us * 1e-6:.1f} s; give a longer recording or duration"
        )
    return start + STEP_US * np.arange(steps + 1, dtype=np.int64)
