"""Policies that do what no policy should: each ends its own rollouts, by a named count and without a score."""

import os
import random
import re
import signal
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from olt_closed_loop.evaluation.evaluation import run_closed_loop
from olt_closed_loop.evaluation.score_table import summarize_scores
from olt_closed_loop.simulation.policies import BatchPolicy, ConstantVelocityPolicy
from olt_closed_loop.simulation.policy_hosts import PolicyLimits
from olt_closed_loop.simulation.settings import SimulationSettings
from olt_generator.errors import InputError
from olt_toolkit.policy.contract import PlannedTrajectory

SHORT = SimulationSettings(duration_us=4_000_000)
FIRST_BAD_CALL = 5


class Steady:
    """Goes straight on; in some scenes and from the fifth call on, a subclass does something else."""

    name, cameras, image_size = "steady", (), (0, 0)

    def reset(self, seed, scene):
        self.calls, self.scene = 0, scene

    def plan(self, observation):
        self.calls += 1
        plan = ConstantVelocityPolicy().plan(observation)
        bad = self.scene == "bad" and self.calls >= FIRST_BAD_CALL
        return self.misbehave(plan, observation) if bad else plan

    def misbehave(self, plan, observation):
        return plan


def changing(change):
    """A policy whose bad answer is made of the good one."""

    class Changed(Steady):
        def misbehave(self, plan, observation):
            return change(plan, observation)

    return Changed


def raising(error):
    def change(plan, observation):
        raise error

    return change


def jump(plan, observation):
    xyz = plan.xyz.copy()
    xyz[30:, 1] += 50.0
    return PlannedTrajectory(xyz, plan.rotation)


def flood(plan, observation):
    os.write(1, bytes(1 << 20))
    print("x" * 1_000_000, file=sys.stderr)
    return plan


def swell(plan, observation):
    held = []
    while True:
        held.append(np.ones(1 << 22))


def hang(plan, observation):
    while True:
        time.sleep(1.0)


def change_input(plan, observation):
    observation.history_xyz[0] += 1.0
    return plan


def change_numpy(plan, observation):
    np.random.seed(0)  # noqa: NPY002
    return plan


def change_python(plan, observation):
    random.random()
    return plan


def change_folder(plan, observation):
    os.chdir("/")
    return plan


def crash(plan, observation):
    os.kill(os.getpid(), signal.SIGSEGV)


def with_rotation(change):
    return lambda plan, observation: PlannedTrajectory(plan.xyz, change(plan.rotation))


def with_xyz(change):
    return lambda plan, observation: PlannedTrajectory(change(plan.xyz), plan.rotation)


class _Silent(Exception):
    def __str__(self):
        raise RuntimeError("no words")


BAD = {
    "none": (lambda plan, _: None, "wrong_answers", "NoneType instead of a PlannedTrajectory"),
    "tuple": (lambda plan, _: (plan.xyz, plan.rotation), "wrong_answers", "tuple"),
    "lists": (with_xyz(lambda xyz: xyz.tolist()), "wrong_answers", "xyz of type list"),
    "objects": (with_xyz(lambda xyz: xyz.astype(object)), "wrong_answers", "xyz of object"),
    "complex": (with_xyz(lambda xyz: xyz.astype(complex)), "wrong_answers", "xyz of complex128"),
    "count": (with_xyz(lambda xyz: xyz[:63]), "plans_refused", "shapes"),
    "shape": (with_rotation(lambda rotation: rotation[..., :2]), "plans_refused", "shapes"),
    "nan": (with_xyz(lambda xyz: xyz * np.nan), "plans_refused", "more than 5 plans in a row.*not finite"),
    "infinite": (with_rotation(lambda rotation: rotation + np.inf), "plans_refused", "not finite"),
    "huge": (with_xyz(lambda xyz: xyz + 1e300), "plans_refused", "within 0.1 s"),
    "jump": (jump, "plans_refused", "moves 50 m within 0.1 s"),
    "zeros": (with_rotation(lambda rotation: 0.0 * rotation), "plans_refused", "no rotations"),
    "mirrored": (with_rotation(lambda rotation: rotation * [1.0, 1.0, -1.0]), "plans_refused", "no rotations"),
    "sheared": (with_rotation(lambda rotation: rotation + 0.1), "plans_refused", "no rotations"),
    "error": (raising(ValueError("no idea")), "policy_errors", "raised ValueError at 2.1 s: no idea"),
    "silent error": (raising(_Silent()), "policy_errors", "raised _Silent"),
    "memory": (raising(MemoryError()), "policy_errors", "raised MemoryError"),
    "exit": (raising(SystemExit(3)), "policy_exits", "called for an exit at 2.1 s: 3"),
    "generator exit": (raising(GeneratorExit()), "policy_errors", "raised GeneratorExit"),
    "input": (change_input, "inputs_changed", "history_xyz"),
    "numpy": (change_numpy, "globals_changed", "numpy.random"),
    "python": (change_python, "globals_changed", "the state of random"),
    "folder": (change_folder, "globals_changed", "working folder"),
}
"""What ends a rollout wherever the policy runs: the answer, the count, and the words."""

BAD_IN_PROCESS = {
    "interrupt": (raising(KeyboardInterrupt()), "policy_deaths", "exit code 1"),
    "hard exit": (lambda plan, _: os._exit(7), "policy_deaths", "exit code 7 at 2.1 s"),
    "crash": (crash, "policy_deaths", "died of SIGSEGV"),
    "hang": (hang, "policy_timeouts", "no answer within 4 s"),
    "swell": (swell, "policy_errors", "raised .*MemoryError"),
}
"""What only a policy in a process of its own survives."""

LIMITED = PolicyLimits(isolate="process", call_seconds=60.0, memory_bytes=1 << 28)


def scenes_around(straight_scene):
    return [replace(straight_scene(duration=4.0), name=name) for name in ("before", "bad", "after")]


def without_timings(results):
    return [(replace(rollout, timings={}).to_dict(), score) for rollout, score in results]


def drive_bad(scenes, change, limits):
    return run_closed_loop(scenes, changing(change)(), 1, settings=replace(SHORT, limits=limits))


@pytest.fixture(scope="module")
def good(straight_scene):
    """The same scenes driven by the policy that does nothing wrong."""
    return without_timings(run_closed_loop(scenes_around(straight_scene), Steady(), 1, settings=SHORT))


def check_only_the_bad_one_fails(results, good, counted, words):
    (_, bad, _) = results
    rollout, score = bad
    assert rollout.failure_kind == counted and getattr(rollout.incidents, counted) >= 1
    assert score.rollout_incidents[counted] >= 1
    assert score.score is None and not score.valid
    assert re.search(words, score.reason), score.reason
    assert without_timings([results[0], results[2]]) == [good[0], good[2]]
    overall = summarize_scores([score for _, score in results]).overall
    assert (overall.rollouts, overall.valid, overall.alpasim_score) == (3, 2, 1.0)


@pytest.mark.parametrize("kind", BAD)
@pytest.mark.parametrize("isolate", ["none", "process"])
def test_what_a_bad_policy_does_ends_its_own_rollout(straight_scene, good, kind, isolate):
    change, counted, words = BAD[kind]
    folder, state = os.getcwd(), random.getstate()
    results = drive_bad(scenes_around(straight_scene), change, replace(LIMITED, isolate=isolate))
    check_only_the_bad_one_fails(results, good, counted, words)
    assert os.getcwd() == folder and random.getstate() == state


@pytest.mark.parametrize("kind", BAD_IN_PROCESS)
def test_what_a_bad_policy_does_to_its_process_ends_its_own_rollout(straight_scene, good, kind):
    change, counted, words = BAD_IN_PROCESS[kind]
    limits = replace(LIMITED, call_seconds=4.0) if kind == "hang" else LIMITED
    check_only_the_bad_one_fails(drive_bad(scenes_around(straight_scene), change, limits), good, counted, words)


def test_a_policy_that_floods_its_output_is_not_heard(straight_scene, good, capfd):
    results = drive_bad(scenes_around(straight_scene), flood, LIMITED)
    states = [replace(rollout, timings={}).to_dict() for rollout, _ in results]
    assert [score.score for _, score in results] == [1.0] * 3 and states == [rollout for rollout, _ in good]
    assert capfd.readouterr() == ("", "")


class Tearing(Steady):
    """Leaves behind what ends its process as soon as the next rollout begins, or spoils what it then answers."""

    def __init__(self, way):
        self.way, self.torn = way, False

    def reset(self, seed, scene):
        if self.torn:
            os._exit(1)
        super().reset(seed, scene)

    def misbehave(self, plan, observation):
        self.torn = True
        if self.way == "error":
            raise ValueError("torn")
        return plan


@pytest.mark.parametrize(("way", "valid"), [("error", [True, False, True]), ("silence", [True, True, True])])
def test_what_one_rollout_leaves_behind_does_not_reach_the_next(straight_scene, way, valid):
    results = run_closed_loop(scenes_around(straight_scene), Tearing(way), 1, settings=SHORT)
    assert [score.valid for _, score in results] == valid


class Refusing(Steady):
    """Every so many-th plan is refused."""

    def __init__(self, every):
        self.every = every

    def plan(self, observation):
        plan = super().plan(observation)
        return PlannedTrajectory(plan.xyz * np.nan, plan.rotation) if self.calls % self.every == 0 else plan


def test_a_stated_share_of_refused_plans_fails_the_rollout(straight_scene):
    scenes = [straight_scene()]
    ((few, valued),) = run_closed_loop(scenes, Refusing(11), 1)
    assert few.incidents.plans_refused == 5 and valued.score == 1.0
    ((many, unvalued),) = run_closed_loop(scenes, Refusing(9), 1)
    assert unvalued.score is None and unvalued.reason == "7 of 63 plans were refused, more than 10 %"
    assert many.failure_kind == "plans_refused"
    allowed = SimulationSettings(limits=PolicyLimits(refused_share=0.2))
    assert run_closed_loop(scenes, Refusing(9), 1, settings=allowed)[0][1].score == 1.0


class BadInBatch(BatchPolicy):
    """One scene's rollout spoils the answer to all of the batch."""

    name = "batch"

    def __init__(self, spoil):
        self.spoil = spoil

    def plan_batch(self, observations):
        plans = ConstantVelocityPolicy().plan_batch(observations)
        slow = observations.history_xyz[:, -1, 0] - observations.history_xyz[:, -2, 0] < 0.5
        return self.spoil(plans) if slow.any() else plans


@pytest.mark.parametrize(
    ("spoil", "kind"),
    [
        (lambda plans: None, "wrong_answers"),
        (lambda plans: PlannedTrajectory(plans.xyz[:0], plans.rotation[:0]), "wrong_answers"),
        (lambda plans: os._exit(1), "policy_deaths"),
        (lambda plans: np.random.seed(1), "globals_changed"),  # noqa: NPY002
    ],
)
def test_one_rollout_of_a_batch_fails_alone(straight_scene, spoil, kind):
    scenes = [
        straight_scene(),
        replace(straight_scene(speed=4.0), name="slow"),
        replace(straight_scene(), name="last"),
    ]
    (first, _), (slow, _), (last, _) = run_closed_loop(scenes, BadInBatch(spoil), 1, settings=SHORT)
    assert (first.failure, slow.failure_kind, last.failure) == (None, kind, None)


class Forgetful:
    """Veers off by how often it was ever asked; has no reset, so only a new one begins at none."""

    name, cameras, image_size = "forgetful", (), (0, 0)

    def __init__(self):
        self.calls = []

    def plan(self, observation):
        self.calls.append(observation.seed)
        plan = ConstantVelocityPolicy().plan(observation)
        wobble = 1e-3 * len(self.calls) * np.sin(np.arange(64))
        return PlannedTrajectory(plan.xyz + np.outer(wobble, [0.0, 1.0, 0.0]), plan.rotation)


class Resetting(Forgetful):
    name = "forgetful"

    def reset(self, seed, scene):
        self.calls.clear()


@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    policy=st.sampled_from([Forgetful, Forgetful(), Resetting, Resetting()]),
    isolate=st.sampled_from(["none", "process"]),
    order=st.permutations(["a", "b", "c"]),
)
def test_memory_never_crosses_rollouts(straight_scene, policy, isolate, order):
    limits = PolicyLimits(isolate=isolate)
    scenes = {name: replace(straight_scene(duration=2.5), name=name) for name in order}
    together = run_closed_loop(
        [scenes[name] for name in order], policy, 2, settings=SimulationSettings(duration_us=2_500_000, limits=limits)
    )
    for name, seed in [(name, seed) for name in order for seed in (0, 1)]:
        alone = run_closed_loop([scenes[name]], Forgetful, 1, seed, SimulationSettings(duration_us=2_500_000))
        (one,) = [result for result in together if (result[0].scene, result[0].seed) == (name, seed)]
        assert without_timings([one]) == without_timings(alone)


@pytest.mark.slow
def test_memory_never_crosses_workers(straight_scene):
    scenes = scenes_around(straight_scene)
    alone = run_closed_loop(scenes, Forgetful, 3, settings=SHORT)
    together = run_closed_loop(scenes, Forgetful(), 3, settings=SHORT, workers=2)
    assert without_timings(alone) == without_timings(together)


def test_a_policy_that_cannot_go_to_workers_is_refused_in_words(straight_scene):
    policy = changing(crash)()
    with pytest.raises(InputError, match=r"Changed is not picklable .* give workers=1"):
        run_closed_loop([straight_scene()], policy, settings=SHORT, workers=2)


class Uncopied(Forgetful):
    def __deepcopy__(self, memo):
        raise TypeError("one of its kind")


def test_a_policy_that_cannot_be_made_anew_is_refused_in_words(straight_scene):
    with pytest.raises(InputError, match=r"Uncopied cannot be copied .*one of its kind.*reset"):
        run_closed_loop([straight_scene()], Uncopied(), settings=SHORT)


def build_badly():
    os._exit(9)


def build_with_error():
    raise RuntimeError("no weights")


@pytest.mark.parametrize(
    ("factory", "kind", "words"),
    [
        (build_badly, "policy_deaths", "ended its process with exit code 9"),
        (build_with_error, "policy_errors", "raised RuntimeError when it was built: no weights"),
        (lambda: sys.exit(2), "policy_exits", "called for an exit"),
    ],
)
def test_a_policy_that_cannot_be_built_fails_every_rollout(straight_scene, factory, kind, words):
    for rollout, score in run_closed_loop(scenes_around(straight_scene), factory, 1, settings=SHORT):
        assert rollout.failure_kind == kind and getattr(rollout.incidents, kind) == 1
        assert words in score.reason and score.score is None


@pytest.mark.parametrize(
    ("attributes", "words"),
    [
        ({"name": None}, "`name` is None"),
        ({"cameras": ("camera_of_mine",)}, "camera_of_mine"),
        ({"image_size": (0,)}, "image_size"),
        ({"plan": 3}, "a method `plan`"),
    ],
)
def test_a_policy_that_does_not_keep_the_contract_is_refused(straight_scene, attributes, words):
    policy = Forgetful()
    vars(policy).update(attributes)
    with pytest.raises(InputError, match=words):
        run_closed_loop([straight_scene()], policy, settings=SHORT)
