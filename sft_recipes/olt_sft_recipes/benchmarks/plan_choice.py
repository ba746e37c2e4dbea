"""`olt bench plan_choice`: how true the probabilities of the toy's sight are, and what its worth of way costs."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

if TYPE_CHECKING:
    from olt_generator.poses import Array
    from olt_sft_recipes.toy.occupancy import Occupancy
    from olt_sft_recipes.toy.policy import ToyPolicy
    from olt_toolkit import PolicySample

app = typer.Typer(add_completion=False)

WORTHS = (0.03, 0.06, 0.12, 0.2, 0.4)
BINS = (0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 1.0)
MET = 0.05
"""A plan meets somebody where its contact with what is really taken counts more."""


@dataclass(frozen=True)
class Moment:
    """What the policy would do at one moment, and what happened.

    Attributes:
        plans: (k, 64, 3) that it draws, x, y in metres and yaw in the rig frame.
        speed: at t0, m/s.
        sight, truth: what it thinks is taken, and what is.
        driven: (64, 3) what was driven.
    """

    plans: "Array"
    speed: float
    sight: "Occupancy"
    truth: "Occupancy"
    driven: "Array"


@app.command()
def plan_choice(
    policy: Annotated[Path, typer.Option(help="Folder of a trained toy.")],
    stores: Annotated[list[Path], typer.Option(help="Clip store that knows obstacles; may be given several times.")],
    split: Annotated[str, typer.Option(help="Split whose clips are used.")] = "val",
    samples: Annotated[int, typer.Option(min=1, help="Samples of every clip.")] = 3,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Hold what the policy thinks of its plans against what is really in their way, on held-out drives."""
    from olt_generator.errors import InputError
    from olt_sft_recipes.open_loop import spread_keys
    from olt_sft_recipes.toy.policy import load_toy
    from olt_toolkit import ClipStore
    from olt_toolkit.runtime.console import print_json
    from olt_toolkit.runtime.threads import use_one_thread

    use_one_thread()
    chosen = load_toy(str(policy))
    contract = chosen.model.config.contract
    loaded = (
        sample
        for store in map(ClipStore, stores)
        for sample in store.load_samples(spread_keys(store, split, samples), contract=contract, with_truth=True)
    )
    moments = list(gather_moments(chosen, loaded))
    if not moments:
        raise InputError(
            f"{', '.join(map(str, stores))}: no sample of split {split!r} knows what is where; give stores of the "
            "synthetic world"
        )
    result = {"policy": str(policy), "moments": len(moments), **measure(moments)}
    print_json(result) if as_json else print_result(result)


def gather_moments(policy: "ToyPolicy", samples: "Iterable[PolicySample]") -> "Iterable[Moment]":
    """A moment of each sample that knows what is where."""
    from olt_sft_recipes.open_loop import observe
    from olt_sft_recipes.toy.inputs import cells_along, pad_route, planar_poses
    from olt_sft_recipes.toy.occupancy import Occupancy
    from olt_sft_recipes.training.auxiliary import gather_truth

    for sample in samples:
        observation = observe(sample)
        history = planar_poses(observation.history_xyz, observation.history_rotation)[None]
        routes = pad_route(observation.route_xy)[None]
        along = cells_along(history, routes)
        known, truth = gather_truth([sample], along)
        if not known[0].all():
            continue
        drawn = policy.draw(observation)
        driven = planar_poses(sample.ego_future_xyz[0].astype(np.float64), sample.ego_future_rot[0].astype(np.float64))
        yield Moment(drawn.plans, drawn.speed, drawn.occupancy(), Occupancy.of_truth(truth[0], drawn.line), driven)


def measure(moments: Sequence[Moment]) -> dict[str, Any]:
    """Calibration of contacts of the plans drawn first, and way and contacts of what is chosen at every worth."""
    from olt_sft_recipes.toy.plan_choice import WAY_WORTH, choose_plan, contacts_of_plan

    drawn = [moment.plans[0] for moment in moments]
    thought = np.array([contacts_of_plan(plan, moment.sight) for moment, plan in zip(moments, drawn, strict=True)])
    true = np.array([contacts_of_plan(plan, moment.truth) for moment, plan in zip(moments, drawn, strict=True)])
    driven = float(np.mean([_way(moment.driven) for moment in moments]))
    calibration = []
    for least, most in pairwise(BINS):
        inside = (thought >= least) & ((thought < most) | (most == BINS[-1]))
        row = {"from": least, "to": most, "moments": int(inside.sum()), "thought": None, "true": None}
        if inside.any():
            row |= {"thought": float(thought[inside].mean()), "true": float(true[inside].mean())}
        calibration.append(row)
    choices = [("first plan", drawn)] + [
        (f"{worth:g}", [choose_plan(moment.plans, moment.speed, moment.sight, worth) for moment in moments])
        for worth in WORTHS
    ]
    choices += [("true sight", [choose_plan(moment.plans, moment.speed, moment.truth) for moment in moments])]
    rows = [
        {
            "worth": name,
            "way_share": float(np.mean([_way(plan) for plan in plans])) / driven,
            "meets_share": float(
                np.mean(
                    [contacts_of_plan(plan, moment.truth) > MET for moment, plan in zip(moments, plans, strict=True)]
                )
            ),
        }
        for name, plans in choices
    ]
    return {"own_worth": WAY_WORTH, "driven_m": driven, "calibration": calibration, "choices": rows}


def _way(plan: "Array") -> float:
    """Metres that a plan (64, 3) makes."""
    return float(np.hypot(*np.diff(plan[:, :2], axis=0, prepend=0.0).T).sum())


def print_result(result: dict[str, Any]) -> None:
    """Print what `measure` gives as tables."""
    from olt_toolkit.runtime.console import print_line, print_table

    print_line(
        f"{result['moments']} moments, in whose 6.4 s {result['driven_m']:.1f} m were driven; the policy's own worth "
        f"of way is {result['own_worth']:g}"
    )
    columns = ("thought from", "to", "moments", "thought, mean", "true, mean")
    print_table("Contacts of the first plan", columns, [tuple(row.values()) for row in result["calibration"]])
    columns = ("worth of way", "way, of what was driven", "plans that meet somebody")
    print_table("What is chosen", columns, [tuple(row.values()) for row in result["choices"]])
