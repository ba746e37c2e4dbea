"""What comes of asking a policy: a plan, a plan that is refused, or a fault that ends the rollout."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from olt_closed_loop.control.plans import MAX_PLAN_SPEED, PlanRefused
from olt_generator.poses import Array
from olt_toolkit.policy.contract import FUTURE_STEPS, STEP_SECONDS, PlannedTrajectory

FaultKind = Literal[
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

    kind: FaultKind
    what: str
    detail: str = ""

    def at(self, seconds: float) -> str:
        """The sentence, with the time of the rollout."""
        return f"the policy {self.what} at {seconds:.1f} s{f': {self.detail}' if self.detail else ''}"


class PolicyFaulted(Exception):
    """Raised by a policy that knows what kind of fault ends its rollout, as one at the end of a connection does."""

    def __init__(self, fault: PolicyFault) -> None:
        super().__init__(f"the policy {fault.what}{f': {fault.detail}' if fault.detail else ''}")
        self.fault = fault


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
    if isinstance(answer, PlanRefused):
        return answer
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
        finite = np.logical_and(np.isfinite(xyz).all(axis=(1, 2)), np.isfinite(rotation).all(axis=(1, 2, 3)))
        moves = np.diff(xyz, axis=1, prepend=0.0)
        steps = np.sqrt(np.sum(moves * moves, axis=2).max(axis=1))
        bent = _distance_from_rotations(rotation).max(axis=(1, 2, 3))
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


def _distance_from_rotations(matrices: Array) -> Array:
    """By how much the products of the columns of matrices (..., 3, 3) differ from a rotation's, (..., 2, 3).

    The third column is to be the vector product of the others, and these of unit length and at right angles.
    """
    x, y, z = np.moveaxis(matrices, -2, 0)  # each (..., 3): the columns' x, y, z
    first, second, third = (x[..., 0], y[..., 0], z[..., 0]), (x[..., 1], y[..., 1], z[..., 1]), matrices[..., 2]
    product = [first[i - 2] * second[i - 1] - first[i - 1] * second[i - 2] for i in range(3)]
    lengths = x * x + y * y + z * z
    across = x[..., 0] * x[..., 1] + y[..., 0] * y[..., 1] + z[..., 0] * z[..., 1]
    plane = [lengths[..., 0] - 1.0, lengths[..., 1] - 1.0, across]
    return np.abs(np.stack([np.stack(product, axis=-1) - third, np.stack(plane, axis=-1)], axis=-2))


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
