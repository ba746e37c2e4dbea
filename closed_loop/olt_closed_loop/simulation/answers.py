"""What comes of asking a policy: a plan, a plan that is refused, or a fault that ends the rollout."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from olt_closed_loop.control.plans import MAX_PLAN_SPEED, PlanRefused
from olt_generator.poses import Array
from olt_toolkit.policy.contract import FUTURE_STEPS, STEP_SECONDS, PlannedTrajectory

PolicyEvent = Literal[
    "policy_errors",
    "policy_exits",
    "policy_deaths",
    "policy_timeouts",
    "wrong_answers",
    "inputs_changed",
    "globals_changed",
]
"""How a policy can end its rollout; each is counted in `rollouts.rollout.Incidents`."""

ROTATION_TOLERANCE = 0.01
"""How far products of a rotation's columns may be from those of a rotation; bfloat16 leaves 0.004 a factor."""
_LONGEST_STEP = MAX_PLAN_SPEED * STEP_SECONDS
_MOST_CHARACTERS = 500


@dataclass(frozen=True)
class PolicyFault:
    """What a policy did that ends its rollout: the kind, and in words what "the policy" did, and more of it."""

    event: PolicyEvent
    what: str
    detail: str = ""

    def at(self, seconds: float) -> str:
        """The sentence, with the time of the rollout."""
        return f"the policy {self.what} at {seconds:.1f} s{f': {self.detail}' if self.detail else ''}"


Answer = PlannedTrajectory | PlanRefused | PolicyFault


def word_error(error: BaseException) -> str:
    """What an error says, on one line of bounded length, even where it cannot say it."""
    try:
        text = str(error)
    except Exception:
        return "(its message cannot be made)"
    return " ".join(text[:_MOST_CHARACTERS].split())


def check_answer(answer: object) -> Answer:
    """One answer of `Policy.plan`: checked, and copied, so that the policy cannot change it any more."""
    wrong = _wrong_kind(answer)
    if wrong or not isinstance(answer, PlannedTrajectory):
        return PolicyFault("wrong_answers", wrong)
    if answer.xyz.shape != (FUTURE_STEPS, 3) or answer.rotation.shape != (FUTURE_STEPS, 3, 3):
        return PlanRefused(
            f"plan of shapes {answer.xyz.shape}, {answer.rotation.shape} instead of {FUTURE_STEPS} poses"
        )
    return check_plans(answer.xyz[None], answer.rotation[None])[0]


def check_batch(answer: object, count: int) -> list[Answer]:
    """An answer of `BatchPolicy.plan_batch` to `count` rows; one of a wrong form is a fault of every row."""
    wrong = _wrong_kind(answer)
    if wrong or not isinstance(answer, PlannedTrajectory):
        return [PolicyFault("wrong_answers", wrong)] * count
    if answer.xyz.shape != (count, FUTURE_STEPS, 3) or answer.rotation.shape != (count, FUTURE_STEPS, 3, 3):
        shapes = f"{answer.xyz.shape}, {answer.rotation.shape}"
        return [PolicyFault("wrong_answers", f"answered {count} rollouts with arrays of shapes {shapes}")] * count
    return check_plans(answer.xyz, answer.rotation)


def check_plans(xyz: Array, rotation: Array) -> list[Answer]:
    """Plans (n, 64, 3) and (n, 64, 3, 3) by row, or why a row is refused.

    Refused is what is not finite, what moves farther in 0.1 s than any vehicle here drives, and what is no rotation:
    columns that are not of unit length, not at right angles, or left-handed.
    """
    xyz, rotation = np.array(xyz, dtype=np.float64), np.array(rotation, dtype=np.float64)
    # Numbers near the largest overflow to infinity or NaN, which no comparison below lets pass.
    with np.errstate(over="ignore", invalid="ignore"):
        finite = np.isfinite(xyz).all(axis=(1, 2)) & np.isfinite(rotation).all(axis=(1, 2, 3))
        steps = np.linalg.norm(np.diff(xyz, axis=1, prepend=0.0), axis=2).max(axis=1)
        first, second, third = np.moveaxis(rotation, -1, 0)
        errors = [
            np.sum(first * first, axis=-1) - 1.0,
            np.sum(second * second, axis=-1) - 1.0,
            np.sum(first * second, axis=-1),
            np.linalg.norm(np.cross(first, second) - third, axis=-1),
        ]
        bent = np.max(np.abs(np.stack(errors)), axis=(0, 2))
    answers: list[Answer] = []
    for row in range(len(xyz)):
        if not finite[row]:
            answers.append(PlanRefused("plan is not finite"))
        elif not steps[row] <= _LONGEST_STEP:
            answers.append(
                PlanRefused(f"plan moves {steps[row]:.3g} m within 0.1 s; at most {MAX_PLAN_SPEED:.0f} m/s are driven")
            )
        elif not bent[row] <= ROTATION_TOLERANCE:
            answers.append(PlanRefused("rotations of the plan are no rotations"))
        else:
            answers.append(PlannedTrajectory(xyz[row], rotation[row]))
    return answers


def _wrong_kind(answer: object) -> str:
    """What an answer is instead of a planned trajectory of numbers, in words; nothing where it is one."""
    if not isinstance(answer, PlannedTrajectory):
        return f"answered with {type(answer).__name__} instead of a PlannedTrajectory"
    for name, values in (("xyz", answer.xyz), ("rotation", answer.rotation)):
        if not isinstance(values, np.ndarray):
            return f"answered with {name} of type {type(values).__name__} instead of a numpy array"
        if values.dtype.kind not in "fiu":
            return f"answered with {name} of {values.dtype} instead of numbers"
    return ""
