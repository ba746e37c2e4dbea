"""Where a policy runs, and how every rollout gets one in a known state.

A policy with `reset` (`olt_toolkit.policy.contract.Resettable`) is told of each rollout. A `BatchPolicy` keeps nothing
by contract. Any other policy is made anew for each rollout: by its factory, or as a copy of the object as it was given.

A policy runs either in this process (`LocalPolicy`) or in one of its own (`simulation.policy_process`), where it cannot
hang, exit, crash or swell but for itself.
"""

import copy
import os
import random
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np

from olt_closed_loop.control.plans import PlanRefused
from olt_closed_loop.simulation.answers import Answer, PolicyFault, PolicyFaulted, check_answer, check_batch, word_error
from olt_closed_loop.simulation.policies import BatchPolicy, ObservationBatch, find_policy, make_policy
from olt_generator.errors import InputError
from olt_toolkit.policy.contract import Observation, Policy, Resettable
from olt_toolkit.rigs.rig import CAMERA_INDEX

PolicySource = str | Policy | Callable[[], Policy]
"""NAME or NAME:ARGUMENT (`simulation.policies.make_policy`), a policy, or a factory of it."""
Isolation = Literal["auto", "none", "process"]

# A worker's answer to SIGTERM (`olt_toolkit.runtime.workers`): no policy's doing.
_TOLD_TO_STOP = 143


@dataclass(frozen=True)
class PolicyLimits:
    """What a policy may take, and how far it may fail its rollout before that has no score.

    Attributes:
        isolate: "process": in a process of its own, where all of this holds; "none": in the simulator's, where time and
            memory have no limit and a crash ends the run; "auto": `run_closed_loop` gives all but the policies of this
            package a process, `simulate` none.
        call_seconds: wall time for one answer.
        start_seconds: wall time for building the policy, and for its `reset`.
        memory_bytes: data that the policy's process may allocate beyond what it begins with, or None for any. Held
            where the system has RLIMIT_DATA (Linux).
        refused_in_a_row: most plans refused in a row.
        refused_share: most plans refused, as a share of all of a rollout.
    """

    isolate: Isolation = "auto"
    call_seconds: float = 30.0
    start_seconds: float = 300.0
    memory_bytes: int | None = 8 << 30
    refused_in_a_row: int = 5
    refused_share: float = 0.1

    def __post_init__(self) -> None:
        if not (self.call_seconds > 0.0 and self.start_seconds > 0.0):
            raise InputError(f"a policy's {self.call_seconds:g} s a call, {self.start_seconds:g} s to start: give more")
        if self.memory_bytes is not None and self.memory_bytes <= 0:
            raise InputError(f"a policy's memory of {self.memory_bytes} bytes: give more than 0, or none for any")


@dataclass(frozen=True)
class PolicyTraits:
    """What a policy says of itself, read once; see `Policy` and `BatchPolicy`."""

    name: str
    cameras: tuple[str, ...] = ()
    image_size: tuple[int, int] = (0, 0)
    answers_batches: bool = False
    uses_route: bool = True
    resets: bool = False
    closes: bool = False

    @classmethod
    def of(cls, policy: Policy) -> "PolicyTraits":
        """The traits of a policy.

        Raises:
            InputError: an attribute of the contract is missing or of another form, or a camera is not known.
        """
        who = f"policy {type(policy).__name__}"
        try:
            name, cameras, size = policy.name, tuple(policy.cameras), tuple(int(side) for side in policy.image_size)
        except (AttributeError, TypeError, ValueError) as error:
            raise InputError(f"{who}: give `name`, `cameras`, `image_size` and `plan` ({error})") from error
        if not isinstance(name, str) or not name or not callable(getattr(policy, "plan", None)):
            raise InputError(f"{who}: `name` is {name!r}; give a text, and a method `plan`")
        unknown = [camera for camera in cameras if camera not in CAMERA_INDEX]
        if unknown or sorted(set(cameras), key=lambda camera: CAMERA_INDEX[camera]) != list(cameras):
            raise InputError(f"{who}: cameras {list(cameras)}; name some of {', '.join(CAMERA_INDEX)}, in this order")
        if len(size) != 2 or (cameras and min(size) <= 0):
            raise InputError(f"{who}: image_size is {size}; give the height and width of its images")
        batches = isinstance(policy, BatchPolicy)
        route = policy.uses_route if isinstance(policy, BatchPolicy) else True
        resets, closes = isinstance(policy, Resettable), isinstance(policy, ClosablePolicy)
        return cls(name, cameras, (size[0], size[1]), batches, route, resets, closes)


@runtime_checkable
class TimedPolicy(Protocol):
    """A policy that keeps limits of time itself and says so by `PolicyFaulted`, as one at the end of a connection."""

    def limit_time(self, call_seconds: float, start_seconds: float) -> None:
        """Take these limits from now on (`PolicyLimits`)."""
        ...


@runtime_checkable
class ClosablePolicy(Protocol):
    """A policy that holds something open, which it is told to close after the last rollout."""

    def close(self) -> None:
        """Close it."""
        ...


@runtime_checkable
class PolicyHost(Protocol):
    """A policy, wherever it runs; whatever it does becomes an `Answer`."""

    traits: PolicyTraits

    def begin(self, seed: int, scene: str) -> PolicyFault | None:
        """Bring the policy into the state in which a rollout begins."""
        ...

    def plan(self, observation: Observation) -> Answer:
        """Ask for one plan."""
        ...

    def plan_batch(self, observations: ObservationBatch) -> list[Answer]:
        """Ask a `BatchPolicy` for the plan of every row; what it does wrong as a whole is a fault of every row."""
        ...

    def close(self) -> None:
        """End what runs."""
        ...


class LocalPolicy:
    """A policy in this process. Those of this package are not watched: their tests show that they change nothing."""

    def __init__(self, source: PolicySource, borrowed: bool = False, limits: PolicyLimits | None = None) -> None:
        """Build the policy. A `borrowed` object drives itself, not as a copy. A `TimedPolicy` takes the limits.

        Raises:
            InputError: the policy is not known, does not keep the contract, or cannot be copied.
            PolicyFaulted: it says that it cannot drive.
        """
        self._make = _factory_of(source, borrowed)
        self._policy = self._make()
        self._owned = self._policy is not source
        if limits and isinstance(self._policy, TimedPolicy):
            self._policy.limit_time(limits.call_seconds, limits.start_seconds)
        self.traits = PolicyTraits.of(self._policy)
        self._used = False
        self._watched = not is_of_package(source)

    def begin(self, seed: int, scene: str) -> PolicyFault | None:
        """See `PolicyHost.begin`."""
        if isinstance(self._policy, Resettable):
            policy = self._policy
            return _guard(lambda: policy.reset(seed, scene), self._watched)[1]
        if self._used and not self.traits.answers_batches:
            self.close()
            self._policy, fault = _guard(self._make, self._watched)
            return fault
        self._used = True
        return None

    def plan(self, observation: Observation) -> Answer:
        """See `PolicyHost.plan`."""
        shown = copy.deepcopy(observation) if self._watched else observation
        answer, fault = _guard(lambda: self._policy.plan(shown), self._watched)
        return fault or _changed(observation, shown) or check_answer(answer)

    def plan_batch(self, observations: ObservationBatch) -> list[Answer]:
        """See `PolicyHost.plan_batch`."""
        policy, count = self._policy, len(observations.seeds)
        if not isinstance(policy, BatchPolicy):
            raise TypeError(f"{self.traits.name} answers one observation at a time")
        shown = copy.deepcopy(observations) if self._watched else observations
        answer, fault = _guard(lambda: policy.plan_batch(shown), self._watched)
        fault = fault or _changed(observations, shown)
        return [fault] * count if fault else check_batch(answer, count)

    def close(self) -> None:
        """Have the policy close what it holds, unless it is someone else's."""
        if self._owned and isinstance(self._policy, ClosablePolicy):
            _guard(self._policy.close, self._watched)


def _factory_of(source: PolicySource, borrowed: bool) -> Callable[[], Policy]:
    if isinstance(source, str):
        return lambda: make_policy(source)
    if isinstance(source, type) or not hasattr(source, "plan"):
        if not callable(source):
            raise InputError(f"policy {source!r}: give a name, an object with a method `plan`, or a factory of one")
        return source
    if borrowed or isinstance(source, Resettable | BatchPolicy):
        return lambda: source  # pyright: ignore[reportReturnType]
    try:
        given = copy.deepcopy(source)
    except Exception as error:
        raise InputError(
            f"policy {type(source).__name__} cannot be copied for every rollout ({word_error(error)}); "
            "give it a method `reset(seed, scene)`, or give a factory"
        ) from error
    return lambda: copy.deepcopy(given)  # pyright: ignore[reportReturnType]


def _guard(call: Callable[[], Any], watched: bool) -> tuple[Any, PolicyFault | None]:
    """What a call of a policy gives, or the fault that it is; if watched, global states are as before afterwards."""
    before = _Globals() if watched else None
    try:
        answer = call()
    except KeyboardInterrupt:
        raise
    except PlanRefused as refusal:
        answer = refusal
    except PolicyFaulted as error:
        return None, error.fault
    except SystemExit as error:
        if error.code == _TOLD_TO_STOP:
            raise
        return None, PolicyFault("policy_exits", "called for an exit", word_error(error))
    except BaseException as error:  # whatever a foreign policy raises ends its own rollout and no other
        return None, PolicyFault("policy_errors", f"raised {type(error).__name__}", word_error(error))
    finally:
        changed = before.restore() if before else ""
    if changed:
        return None, PolicyFault(
            "globals_changed", f"changed {changed}", "give it a generator of its own, seeded by the observation"
        )
    return answer, None


class _Globals:
    """States that all of a process share, as they are now."""

    def __init__(self) -> None:
        self._numpy, self._python, self._folder = _numpy_state(), random.getstate(), Path.cwd()

    def restore(self) -> str:
        """Bring back what changed; returns what that was."""
        changed = []
        if not all(np.array_equal(now, was) for now, was in zip(_numpy_state(), self._numpy, strict=True)):
            np.random.set_state(self._numpy)  # noqa: NPY002
            changed.append("the state of numpy.random")
        if random.getstate() != self._python:
            random.setstate(self._python)
            changed.append("the state of random")
        folder = None
        with suppress(FileNotFoundError):
            folder = Path.cwd()
        if folder != self._folder:
            os.chdir(self._folder)
            changed.append("the working folder")
        return " and ".join(changed)


def _numpy_state() -> tuple[Any, ...]:
    return tuple(np.random.get_state())  # noqa: NPY002 (what policies may use, not we)


def _changed(given: object, shown: object) -> PolicyFault | None:
    """The fault of a policy that changed what it was shown, a copy of what is given."""
    if shown is given:
        return None
    for name, value in vars(given).items():
        now: Any = vars(shown).get(name)
        floats = isinstance(value, np.ndarray) and value.dtype.kind == "f"  # of which NaN fill up routes
        if now is not value and not np.array_equal(now, value, equal_nan=floats):
            return PolicyFault("inputs_changed", f"changed its observation's {name}", "let it work on a copy")
    return None


def is_of_package(policy: PolicySource) -> bool:
    """Whether a policy is one of this package's own, which are trusted to end and to hurt nothing.

    So is what speaks for a driver elsewhere: the driver itself is another process, and has limits of time.
    """
    if isinstance(policy, str):
        module = getattr(find_policy(policy), "module", "")  # what only loads, and says not whence, is foreign
    else:
        module = (policy if isinstance(policy, type) else type(policy)).__module__
    return module.partition(".")[0] == __name__.partition(".")[0]
