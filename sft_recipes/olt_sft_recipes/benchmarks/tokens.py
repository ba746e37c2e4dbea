"""Trajectory tokens: what their rounding costs, how it grows with the horizon, and what saturates."""

from collections.abc import Sequence
from functools import lru_cache, partial
from typing import Any

import numpy as np

from olt_generator.poses import Array
from olt_sft_recipes.benchmarks.motions import Motions, by_horizon, distances, drawn_motions, drive
from olt_sft_recipes.toy.tokens import STEP_LIMITS, decode_actions, encode_actions
from olt_toolkit.bench.benchmark import Benchmark, Grid, Setting
from olt_toolkit.policy.action_space import (
    ACTION_LIMIT,
    actions_to_trajectory,
    estimate_initial_speed,
    physical_actions,
    trajectory_to_actions,
)

COUNT = 256
_BINS = (100, 300, 1000, 10_000)


@lru_cache(maxsize=1)
def _fitted() -> tuple[Motions, Array, Array]:
    """Motions, and what the action space makes of them: actions (n, 64, 2) and speeds (n,) at t0."""
    motions = drawn_motions(COUNT)
    return motions, *fit(motions)


def fit(motions: Motions) -> tuple[Array, Array]:
    """Normalised actions (n, 64, 2) and speeds (n,) at t0 of motions."""
    history_xyz, history_rotation, xyz, rotation = motions.poses()
    actions = trajectory_to_actions(history_xyz, history_rotation, xyz, rotation)
    return actions, estimate_initial_speed(history_xyz, history_rotation)


def _round(actions: Array, bins: int) -> Array:
    """Actions on that many values evenly spread over the range of the tokens."""
    scaled = (actions + ACTION_LIMIT) / (2.0 * ACTION_LIMIT)
    return np.clip(np.rint(scaled * (bins - 1)), 0, bins - 1) / (bins - 1) * 2.0 * ACTION_LIMIT - ACTION_LIMIT


def _through_tokens(actions: Array) -> Array:
    return decode_actions(encode_actions(actions)[0])


def _drive_through(through: Any) -> Array:
    _, actions, speed = _fitted()
    return actions_to_trajectory(through(actions), speed)[0]


def _settings() -> Sequence[Setting]:
    def prepare(through: Any) -> Any:
        _fitted()
        return partial(_drive_through, through)

    rounded = {f"{bins} values": partial(_round, bins=bins) for bins in _BINS}
    ways = {"3000 tokens": _through_tokens, **rounded, "actions as they are": np.asarray}
    return [Setting(name, partial(prepare, way), default=name == "3000 tokens") for name, way in ways.items()]


def extreme_motions() -> dict[str, Motions]:
    """What strains tokens: standstill, reverse, hard braking, tight turns, and histories that are not smooth."""
    bend = drive(lambda t: 8.0 + 0.0 * t, lambda t: 0.02 + 0.0 * t)
    cases = {
        "standstill": drive(lambda t: 0.0 * t, lambda t: 0.0 * t),
        "creeping, 0.2 m/s": drive(lambda t: 0.2 + 0.0 * t, lambda t: 0.1 + 0.0 * t),
        "reversing at 2 m/s in a curve": drive(lambda t: -2.0 + 0.0 * t, lambda t: 0.05 + 0.0 * t),
        "forwards, then back": drive(lambda t: 2.0 - 0.7 * t, lambda t: 0.05 + 0.0 * t),
        "stop and go": drive(
            lambda t: np.clip(3.0 - 2.0 * t, 0.0, 3.0) + np.clip(1.5 * (t - 4.0), 0.0, 4.0), lambda t: 0.0 * t
        ),
    }
    for braking in (5.0, 6.7, 8.0, 9.5):
        cases[f"braking by {braking:g} m/s^2 from 30 m/s"] = drive(
            lambda t, braking=braking: np.maximum(30.0 - braking * np.maximum(t, 0.0), 0.0), lambda t: 0.0 * t
        )
    for turn in (0.2, 0.26, 0.28, 0.33):
        cases[f"turning by {turn:g} 1/m at 3 m/s"] = drive(lambda t: 3.0 + 0.0 * t, lambda t, turn=turn: turn + 0.0 * t)
    held, filled = bend.history.copy(), bend.history.copy()
    held[:, 5:10] = held[:, 4:5]
    shares = np.linspace(0.0, 1.0, 7)[1:-1, None]
    filled[:, 5:10] = filled[:, 4:5] + shares * (filled[:, 10:11] - filled[:, 4:5])
    cases["curve, history filled over a gap of 0.5 s"] = Motions(filled, bend.future)
    cases["curve, history held over a gap of 0.5 s"] = Motions(held, bend.future)
    return cases


def _stop_and_go(times: Array) -> Array:
    return np.clip(3.0 - 2.0 * times, 0.0, 3.0) + np.clip(1.5 * (times - 4.0), 0.0, 4.0)


def describe_extreme(name: str, motions: Motions) -> dict[str, Any]:
    """Errors of one motion with actions as they are and with tokens, and how many tokens saturate."""
    actions, speed = fit(motions)
    acceleration, curvature = physical_actions(actions[0])
    beyond = np.abs(actions[0]) > ACTION_LIMIT
    plain, coded = (
        distances(actions_to_trajectory(each, speed)[0], motions) for each in (actions, _through_tokens(actions))
    )
    steps = np.abs(np.diff(motions.history[0, :, :2], axis=0)) > STEP_LIMITS[:2]
    return {
        "motion": name,
        "hardest_m_per_s2": float(acceleration[np.argmax(np.abs(acceleration))]),
        "tightest_per_m": float(curvature[np.argmax(np.abs(curvature))]),
        "saturated_accelerations": int(beyond[:, 0].sum()),
        "saturated_curvatures": int(beyond[:, 1].sum()),
        "saturated_history_steps": int(steps.sum()),
        "of_tokens": int(beyond.size),
        "actions_mean_error_m": float(plain.mean()),
        "tokens_mean_error_m": float(coded.mean()),
        "tokens_error_at_end_m": float(coded[0, -1]),
    }


def _grid() -> Grid:
    rows = [describe_extreme(name, motions) for name, motions in extreme_motions().items()]
    summary = [
        f"{row['motion']}: mean error {row['actions_mean_error_m']:.3f} m by actions, "
        f"{row['tokens_mean_error_m']:.3f} m by tokens, {row['tokens_error_at_end_m']:.2f} m at the end; "
        f"{row['saturated_accelerations']} accelerations and {row['saturated_curvatures']} curvatures of 64 saturate"
        for row in rows
    ]
    return Grid(rows, summary)


def _figures(driven: Array) -> dict[str, float]:
    motions, actions, _ = _fitted()
    errors = distances(driven, motions)
    share = 100.0 * float((np.abs(actions) > ACTION_LIMIT).mean())
    return by_horizon(errors) | {"error at 6.4 s, worst (m)": float(errors[:, -1].max()), "saturated (%)": share}


BENCHMARK = Benchmark(
    title=f"{COUNT} drawn motions of 6.4 s as actions and tokens",
    error_name="mean distance",
    error_unit="m",
    reference="the motions, integrated from speed and curvature in steps of 1 ms",
    settings=_settings,
    measure_error=lambda driven: float(distances(driven, _fitted()[0]).mean()),
    figures=_figures,
    grid=_grid,
)
