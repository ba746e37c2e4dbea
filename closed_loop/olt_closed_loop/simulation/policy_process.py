"""A policy in a process of its own, which may hang, exit, crash, swell or print without end: only its rollout ends.

The process has its own session, no terminal and no output, a limit of memory, and dies with the simulator. On Linux it
is forked, so that any object can be given; elsewhere it is started anew and the policy must be picklable. It is kept
from rollout to rollout where the policy resets itself (or has no memory: `BatchPolicy`), and started anew otherwise.

What comes back is text and arrays of a known size, never pickles: one line of JSON with an entry for each answer, and
then 64 * (3 + 9) float64 for each answer that is a plan.
"""

import ctypes
import faulthandler
import json
import os
import pickle
import signal
import sys
from contextlib import suppress
from dataclasses import asdict
from mmap import mmap
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any

import numpy as np

from olt_closed_loop.control.plans import PlanRefused
from olt_closed_loop.simulation.answers import Answer, PolicyFault, PolicyFaulted, word_error
from olt_closed_loop.simulation.policies import ObservationBatch
from olt_closed_loop.simulation.policy_hosts import LocalPolicy, PolicyHost, PolicyLimits, PolicySource, PolicyTraits
from olt_closed_loop.simulation.questions import receive_question, send_question, share_memory
from olt_generator.errors import InputError
from olt_toolkit.policy.contract import FUTURE_STEPS, Observation, PlannedTrajectory
from olt_toolkit.runtime.threads import use_one_thread, without_opencv_threads

_CONTEXT = get_context("fork" if sys.platform == "linux" else "spawn")
_PLAN_VALUES = FUTURE_STEPS * (3 + 9)
_LONGEST_LINE = 1 << 20
_SECONDS_TO_DIE = 5.0
_PR_SET_PDEATHSIG = 1


class PolicyNotStarted(Exception):
    """The process could not build its policy; `fault` says why."""

    def __init__(self, fault: PolicyFault) -> None:
        super().__init__(fault.what)
        self.fault = fault


class PolicyProcess:
    """See `policy_hosts.PolicyHost`."""

    def __init__(self, source: PolicySource, limits: PolicyLimits, context: Any = None) -> None:
        """Start the process and have it build the policy; in another way of multiprocessing if one is given.

        Raises:
            InputError: the policy is not known, does not keep the contract, or cannot be brought into the process.
            PolicyNotStarted: it raised, ended, died or took too long while it was built.
        """
        self._source, self._limits, self._context = source, limits, context or _CONTEXT
        self._used = self._failed = False
        self._start()

    def begin(self, seed: int, scene: str) -> PolicyFault | None:
        """See `PolicyHost.begin`. A process in which something went wrong serves no further rollout."""
        if self._failed or (self._used and not (self.traits.resets or self.traits.answers_batches)):
            self.close()
        kept = self._process is not None
        fault = self._reset(seed, scene)
        if fault and kept:  # by what an earlier rollout left behind
            self._end()
            fault = self._reset(seed, scene)
        return fault

    def _reset(self, seed: int, scene: str) -> PolicyFault | None:
        fault = self._restart()
        self._used = True
        if fault or not self.traits.resets:
            return fault
        faults = self._ask(("begin", seed, scene), 1, self._limits.start_seconds)
        return faults[0] if faults and isinstance(faults[0], PolicyFault) else None

    def plan(self, observation: Observation) -> Answer:
        """See `PolicyHost.plan`."""
        return self._ask(("plan", observation), 1, self._limits.call_seconds)[0]

    def plan_batch(self, observations: ObservationBatch) -> list[Answer]:
        """See `PolicyHost.plan_batch`."""
        count = len(observations.seeds)
        fault = self._restart()
        return [fault] * count if fault else self._ask(("plan_batch", observations), count, self._limits.call_seconds)

    def close(self) -> None:
        """End the process, and those that it started; its policy closes first what it holds (`ClosablePolicy`)."""
        if self._process is not None and self.traits.closes and not self._failed:
            with suppress(OSError):
                send_question(self._connection, self._memory, ("close",))
                self._connection.poll(_SECONDS_TO_DIE)
        self._end()

    def _end(self) -> None:
        if self._process is None:
            return
        self._ending()
        self._connection.close()
        if self._memory is not None:
            self._memory.close()
        self._process, self._failed = None, False

    def _restart(self) -> PolicyFault | None:
        """Start the process again if it has ended."""
        if self._process is not None:
            return None
        try:
            self._start()
        except PolicyNotStarted as error:
            return error.fault
        return None

    def _start(self) -> None:
        self._connection, theirs = self._context.Pipe()
        self._memory = share_memory() if self._context.get_start_method() == "fork" else None
        self._process = self._context.Process(
            target=_serve, args=(theirs, self._connection, self._memory, self._source, self._limits)
        )
        try:
            with without_opencv_threads():
                self._process.start()
        except (AttributeError, TypeError, pickle.PicklingError) as error:
            self._process = None
            raise InputError(
                f"policy {type(self._source).__name__} is not picklable ({word_error(error)}), so it cannot have a "
                "process of its own here; define it at the top of a module, or isolate 'none'"
            ) from error
        theirs.close()
        # Before multiprocessing waits, at the end of this process, for all that it started.
        self._ending = Finalize(None, _kill, args=(self._process,), exitpriority=10)
        told = self._receive(0, self._limits.start_seconds)
        if isinstance(told, PolicyFault):
            raise PolicyNotStarted(told)
        values = json.loads(told)
        if "refused" in values:
            self._end()
            raise InputError(values["refused"])
        if "fault" in values:
            self._end()
            raise PolicyNotStarted(PolicyFault(**values["fault"]))
        traits = values["traits"]
        self.traits = PolicyTraits(
            **traits | {"cameras": tuple(traits["cameras"]), "image_size": tuple(traits["image_size"])}
        )

    def _ask(self, question: tuple[Any, ...], count: int, seconds: float) -> list[Answer]:
        try:
            send_question(self._connection, self._memory, question)
        except OSError:
            return [self._bury()] * count
        told = self._receive(count, seconds)
        answers: list[Answer] = [told] * count if isinstance(told, PolicyFault) else _decode(told)
        self._failed = any(isinstance(answer, PolicyFault) for answer in answers)
        return answers

    def _receive(self, count: int, seconds: float) -> bytes | PolicyFault:
        try:
            if not self._connection.poll(seconds):
                self._end()
                return PolicyFault("policy_timeouts", f"gave no answer within {seconds:g} s")
            return self._connection.recv_bytes(_LONGEST_LINE + 8 * _PLAN_VALUES * count)
        except (EOFError, OSError):
            return self._bury()

    def _bury(self) -> PolicyFault:
        """The fault of a process that ended by itself."""
        process = self._process
        if process is None:
            raise RuntimeError("the policy's process was not started")
        process.join(_SECONDS_TO_DIE)
        code = process.exitcode
        self._end()
        if code is None:
            how = "closed its connection"
        elif code < 0:
            how = f"died of {signal.Signals(-code).name}"
        else:
            how = f"ended its process with exit code {code}"
        return PolicyFault("policy_deaths", how)


def host_policy(source: PolicySource, limits: PolicyLimits, borrowed: bool = False, context: Any = None) -> PolicyHost:
    """The policy where the limits want it; "auto" is this process. For `context` see `PolicyProcess`.

    Raises:
        InputError: see `LocalPolicy` and `PolicyProcess`.
        PolicyNotStarted: it, or its process, could not be built.
    """
    if limits.isolate == "process":
        return PolicyProcess(source, limits, context)
    try:
        return LocalPolicy(source, borrowed, limits)
    except PolicyFaulted as error:
        raise PolicyNotStarted(error.fault) from error


def _kill(process: BaseProcess) -> None:
    """End a process, and those that it started: its session is its own."""
    if process.pid:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.join()


def _serve(
    connection: Connection, theirs: Connection, memory: mmap | None, source: PolicySource, limits: PolicyLimits
) -> None:
    """What the process does: build the policy, then answer until the simulator is gone."""
    theirs.close()
    _set_apart()
    _limit_memory(limits.memory_bytes)
    use_one_thread()
    if "torch" in sys.modules:  # whose threads are not in a fork: more than one would wait for ever
        sys.modules["torch"].set_num_threads(1)
    try:
        policy = LocalPolicy(source, limits=limits)
        told = {"traits": asdict(policy.traits)}
    except InputError as error:
        policy, told = None, {"refused": str(error)}
    except PolicyFaulted as error:
        policy, told = None, {"fault": asdict(error.fault)}
    except SystemExit as error:
        policy, told = None, {"fault": asdict(PolicyFault("policy_exits", "called for an exit", word_error(error)))}
    except Exception as error:
        fault = PolicyFault("policy_errors", f"raised {type(error).__name__} when it was built", word_error(error))
        policy, told = None, {"fault": asdict(fault)}
    connection.send_bytes(json.dumps(told).encode())
    while policy is not None:
        try:
            name, *arguments = receive_question(connection, memory)
        except EOFError:
            break
        answer = getattr(policy, name)(*arguments)
        answers = answer if isinstance(answer, list) else [answer] if answer is not None else []
        connection.send_bytes(_encode(answers))
    os._exit(0)  # what a policy registered to run at exit does not run


def _set_apart() -> None:
    """Leave the simulator's terminal, output and signals, and die with it."""
    if hasattr(os, "setsid"):
        os.setsid()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, signal.SIG_DFL)
    faulthandler.disable()
    nowhere = os.open(os.devnull, os.O_RDWR)
    for standard in range(3):
        os.dup2(nowhere, standard)
    # What Python still holds of the simulator's output stays unwritten here.
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        setattr(sys, name, Path(os.devnull).open(mode))  # noqa: SIM115


def _limit_memory(memory_bytes: int | None) -> None:
    if sys.platform != "linux":
        return
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if memory_bytes is not None:
        with Path("/proc/self/status").open() as status:
            used = next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmData:"))
        resource.setrlimit(resource.RLIMIT_DATA, (used + memory_bytes, used + memory_bytes))


def _encode(answers: list[Answer]) -> bytes:
    entries: list[object] = []
    plans = []
    for answer in answers:
        if isinstance(answer, PlannedTrajectory):
            entries.append("plan")
            plans += [answer.xyz.tobytes(), answer.rotation.tobytes()]
        elif isinstance(answer, PlanRefused):
            entries.append({"refused": str(answer)})
        else:
            entries.append({"fault": asdict(answer)})
    return b"\n".join([json.dumps(entries).encode(), b"".join(plans)])


def _decode(told: bytes) -> list[Answer]:
    line, _, data = told.partition(b"\n")
    values = iter(np.frombuffer(data, dtype=np.float64).copy().reshape(-1, _PLAN_VALUES))
    answers: list[Answer] = []
    for entry in json.loads(line):
        if entry == "plan":
            plan = next(values)
            answers.append(
                PlannedTrajectory(
                    plan[: 3 * FUTURE_STEPS].reshape(FUTURE_STEPS, 3), plan[3 * FUTURE_STEPS :].reshape(-1, 3, 3)
                )
            )
        elif "refused" in entry:
            answers.append(PlanRefused(entry["refused"]))
        else:
            answers.append(PolicyFault(**entry["fault"]))
    return answers
