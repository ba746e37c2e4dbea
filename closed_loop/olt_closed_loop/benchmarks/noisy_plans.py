"""What smoothing of plans is worth and what it costs: noise that reaches the wheel, and the delay of a change of mind.

A policy plans anew every 0.1 s from where the rig is along a reference that it knows, with noise of 0.25 m added: one
offset of a whole plan or of every pose. Three drives at 10 m/s are clean, noisy plan by plan, and noisy pose by pose.
In others the plans jump sideways, by half a metre or by a lane.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from olt_closed_loop.control.plans import WorldPlan
from olt_closed_loop.control.tracking import ControlSettings, TrackingController
from olt_closed_loop.vehicle.integrators import VehicleStepper
from olt_closed_loop.vehicle.parameters import VehicleParameters
from olt_closed_loop.vehicle.state import STATE
from olt_generator.poses import Array
from olt_generator.seeds import make_generator
from olt_toolkit.policy.contract import FUTURE_STEPS, STEP_SECONDS, STEP_US
from olt_toolkit.rigs.rig import DEFAULT_VEHICLE

SECONDS, SPEED, NOISE, JUMP_AFTER = 12.0, 10.0, 0.25, 4.0
JUMPS = (0.5, 3.5)
"""Metres: a small change of mind, and a lane."""
SWAY_LENGTH, SWAY = 100.0, 2.0
"""Metres of a bend and back of the reference, and how far it goes to either side."""
REVERSAL = np.deg2rad(3.0) / 15.0
"""Of the wheel, from which a turn back counts (SAE J2944: 3 degrees of the handwheel; steering ratio 15)."""
SMOOTHINGS: dict[str, tuple[float, float]] = {
    "none": (0.0, 0.0),
    "window 0.2 s": (0.2, 0.0),
    "window 0.4 s": (0.4, 0.0),
    "mean 0.2 s": (0.0, 0.2),
    "mean 0.3 s": (0.0, 0.3),
    "window 0.2 s, mean 0.1 s": (0.2, 0.1),
    "window 0.2 s, mean 0.2 s": (0.2, 0.2),
    "window 0.2 s, mean 0.4 s": (0.2, 0.4),
    "window 0.2 s, mean 0.6 s": (0.2, 0.6),
    "window 0.2 s, mean 0.8 s": (0.2, 0.8),
}
Noise = Callable[[np.random.Generator], Array]


class NoisyDrive(NamedTuple):
    """States (n + 1, 6) of a drive, and its distances (n + 1,) from the reference without noise, metres."""

    states: Array
    errors: Array

    @property
    def reversals(self) -> int:
        """How often the wheel turned back by more than `REVERSAL`."""
        return count_reversals(self.states[:, STATE.steering])

    @property
    def steering_rate(self) -> float:
        """Root mean square of the rate of the wheel, rad/s."""
        return float(np.sqrt(np.square(np.diff(self.states[:, STATE.steering]) / STEP_SECONDS).mean()))

    @property
    def rms(self) -> float:
        """Root mean square of the errors."""
        return float(np.sqrt(np.square(self.errors).mean()))


def count_reversals(angles: Array) -> int:
    """Turns back by more than `REVERSAL` of a wheel that stood at these angles (n,) rad one after the other."""
    count, direction, extreme = 0, 0.0, float(angles[0])
    for angle in angles.tolist():
        if direction * (angle - extreme) > 0.0:
            extreme = angle
        elif abs(angle - extreme) > REVERSAL:
            count += direction != 0.0
            direction, extreme = float(np.sign(angle - extreme)), angle
    return count


def reference(times: NDArray[np.floating[Any]]) -> Array:
    """Poses (n, 3) of a road that sways."""
    wave = 2.0 * np.pi / SWAY_LENGTH
    x = (SPEED * times).astype(np.float64)
    return np.stack([x, SWAY * (1.0 - np.cos(wave * x)), np.arctan(SWAY * wave * np.sin(wave * x))], axis=-1)


def drive(settings: ControlSettings, noise: Noise | None = None, jump: float = 0.0, seed: int = 0) -> NoisyDrive:
    """Follow plans along the reference; `jump` metres to the left from `JUMP_AFTER` seconds on."""
    vehicle = VehicleParameters.from_dimensions(DEFAULT_VEHICLE)
    controller, stepper = TrackingController(vehicle, settings), VehicleStepper(vehicle)
    generator = make_generator(seed, "plans", "noise")
    states = [np.concatenate([reference(np.zeros(1))[0], [SPEED, 0.0, 0.0]])]
    ahead = np.arange(FUTURE_STEPS + 1, dtype=np.int64)
    for step in range(round(SECONDS / STEP_SECONDS)):
        poses = reference(STEP_SECONDS * (step + ahead))
        poses[:, 1] += jump * (step * STEP_SECONDS >= JUMP_AFTER)
        if noise is not None:
            poses[:, :2] += noise(generator)
        poses[0] = states[-1][: STATE.speed]
        plan = WorldPlan(STEP_US * (step + ahead), poses)
        states.append(stepper(states[-1], controller.control(states[-1], plan, step * STEP_US)))
    driven = np.stack(states)
    wanted = reference(STEP_SECONDS * np.arange(len(driven)))
    return NoisyDrive(driven, np.hypot(*(driven - np.pad(wanted, ((0, 0), (0, 3))))[:, : STATE.yaw].T))


def of_plans(generator: np.random.Generator) -> Array:
    """One offset for a whole plan, (1, 2)."""
    return generator.normal(scale=NOISE, size=(1, 2)) * [0.0, 1.0]


def of_poses(generator: np.random.Generator) -> Array:
    """One offset for every pose, (65, 2)."""
    return generator.normal(scale=NOISE, size=(FUTURE_STEPS + 1, 2))


def seconds_to_change(settings: ControlSettings, jump: float) -> float:
    """Seconds from a jump of the plans sideways (m) until the vehicle has come half way."""
    left = drive(settings, jump=jump).states[:, STATE.y] - drive(settings).states[:, STATE.y]
    half = int(np.argmax(left > 0.5 * jump))
    share = (0.5 * jump - left[half - 1]) / (left[half] - left[half - 1])
    return STEP_SECONDS * (half - 1 + share) - JUMP_AFTER


def smoothing_rows() -> list[dict[str, Any]]:
    """One row for every smoothing: reversals, rates of the wheel (rad/s), errors (m), delays against none (s)."""
    rows, without = [], ControlSettings(smoothing_window=0.0, smoothing_delay=0.0)
    quickest = [seconds_to_change(without, jump) for jump in JUMPS]
    for name, (window, delay) in SMOOTHINGS.items():
        settings = ControlSettings(smoothing_window=window, smoothing_delay=delay)
        row: dict[str, Any] = {"smoothing": name}
        for what, noise in (("clean", None), ("noisy plans", of_plans), ("noisy poses", of_poses)):
            driven = drive(settings, noise)
            row[f"{what}: reversals"], row[f"{what}: rate"] = driven.reversals, driven.steering_rate
            row[f"{what}: error"] = driven.rms
        for jump, quick in zip(JUMPS, quickest, strict=True):
            row[f"delay of {jump:g} m"] = seconds_to_change(settings, jump) - quick
        rows.append(row)
    return rows


def told(row: dict[str, Any]) -> str:
    """A row in a line."""
    return ", ".join(
        f"{key} {value:.3f}" if isinstance(value, float) else f"{key} {value}" for key, value in row.items()
    )
