"""The curves of a stage as a picture: loss, learning rate, and what evaluations measured."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from olt_generator.files import write_whole
from olt_sft_recipes.training.checkpoints import TrainerState

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CURVES_FILE = "curves.png"
# Steps over which losses are averaged.
_AVERAGED = 20


def draw_curves(path: Path, state: TrainerState) -> None:
    """Draw them into a PNG file, without a display. Before the first step there is nothing to draw."""
    from matplotlib.figure import Figure

    if not state.log_history:
        return
    steps, losses, rates = (
        np.array([row[name] for row in state.log_history]) for name in ("step", "loss", "learning_rate")
    )
    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    upper, middle, lower = figure.subplots(3, 1, sharex=True)
    upper.plot(steps, losses, linewidth=0.5, alpha=0.5, label="loss of the step")
    window = min(_AVERAGED, len(losses))
    upper.plot(
        steps[window - 1 :],
        np.convolve(losses, np.full(window, 1.0 / window), "valid"),
        label=f"mean of {window} steps",
    )
    judged = [(judged["step"], judged["eval_loss"]) for judged in state.evaluations if judged["eval_loss"] is not None]
    if judged:
        upper.plot(*zip(*judged, strict=True), "o-", label="held-out samples")
    upper.set(title=f"Stage {state.stage}", ylabel="loss", yscale="log" if (losses > 0.0).any() else "linear")
    upper.legend()
    middle.plot(steps, rates)
    middle.set(ylabel="learning rate")
    _draw_errors(lower, state)
    lower.set(xlabel="optimizer step")
    with write_whole(path) as temporary:
        figure.savefig(temporary, format="png", dpi=100)


def _draw_errors(axes: "Axes", state: TrainerState) -> None:
    """Open-loop errors on the left, scores of the closed loop on the right."""
    driven = [(judged["step"], judged["closed_loop"]) for judged in state.evaluations if judged["closed_loop"]]
    for name, label in (("min_ade", "minADE"), ("ade", "ADE"), ("corner_distance", "corner distance")):
        errors = [(judged["step"], judged["open_loop"][name]) for judged in state.evaluations if judged["open_loop"]]
        if errors:
            axes.plot(*zip(*errors, strict=True), "o-", label=label)
    axes.set(ylabel="held-out samples, m")
    if driven:
        scores = axes.twinx()
        for name, label in (("alpasim_score", "AS"), ("collision_rate", "CR")):
            values = [np.nan if scored[name] is None else scored[name] for _, scored in driven]
            scores.plot([step for step, _ in driven], values, "s--", label=label)
        scores.set(ylabel="closed loop", ylim=(-0.05, 1.05))
        scores.legend(loc="upper left")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper right")
    elif not driven:
        axes.text(0.5, 0.5, "no errors measured", transform=axes.transAxes, ha="center")
