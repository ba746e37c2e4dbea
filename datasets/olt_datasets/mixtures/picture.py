"""A picture of the shares of a mixture."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from olt_datasets.mixtures.mixture import GROUPS, Mixture
from olt_generator.files import write_whole
from olt_toolkit.policy.action_space import ROUND_TRIP_TOLERANCE

MOST_BARS = 12
"""Values shown in one panel; the rarer ones are counted together."""


def draw_mixture(mixture: Mixture, path: Path) -> None:
    """Draw what each component was asked for and gave, and the shares by each group, as PNG.

    Beside them where the pixels of each component come from, and how far the futures of samples are from the action
    space. A curriculum adds the shares of the components over the epochs.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    summary = mixture.describe()
    items = max(len(mixture), 1)
    figure, panels = pyplot.subplots(2, 4, figsize=(17, 7), layout="constrained")
    parts = summary["components"]
    if len(mixture.recipe.named_epochs) > 1:
        _draw_curriculum(panels[0, 0], mixture)
    else:
        notes = [f"{part['got']} of {part['available']}" for part in parts]
        _draw_bars(panels[0, 0], {part["name"]: part["got"] / items for part in parts}, notes)
        asked = [part["asked"] / items for part in parts]
        panels[0, 0].plot(asked, range(len(parts)), "k|", ms=22, mew=2)
        panels[0, 0].set_title("components: got (bars) and asked (marks)")
    _draw_pixels(panels.flat[-2], parts)
    _draw_action_errors(panels.flat[-1], mixture)
    for axes, group in zip(panels.flat[1:-2], GROUPS, strict=True):
        by_size = sorted(summary[f"by_{group}"].items(), key=lambda entry: (-entry[1]["got"], entry[0]))
        shares = {value: numbers["got"] / items for value, numbers in by_size[:MOST_BARS]}
        rest = by_size[MOST_BARS:]
        if rest:
            shares[f"{len(rest)} others"] = sum(numbers["got"] for _, numbers in rest) / items
        _draw_bars(axes, shares, [f"{share:.1%}" for share in shares.values()])
        axes.set_title(f"by {group}" + (" (a sample has any number)" if group == "factors" else ""))
    figure.suptitle(f"{mixture.recipe.name}: {len(mixture)} samples per epoch, seed {mixture.seed}")
    with write_whole(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110, metadata={"Software": None})
    pyplot.close(figure)


def _draw_curriculum(axes: Any, mixture: Mixture) -> None:
    epochs = range(mixture.recipe.named_epochs[-1] + 2)
    shares = [[count / len(mixture) for count in mixture.counts(epoch)] for epoch in epochs]
    names = [component.name for component in mixture.recipe.components]
    axes.stackplot(epochs, list(zip(*shares, strict=True)), labels=names, step="post", alpha=0.8)
    axes.set(title="components over epochs", xlabel="epoch", ylabel="share of items", ylim=(0, 1), xlim=(0, epochs[-1]))
    axes.legend(fontsize=8, loc="lower left")


def _draw_pixels(axes: Any, parts: Sequence[Mapping[str, Any]]) -> None:
    left = [0.0] * len(parts)
    for name, colour in (("observed", "tab:blue"), ("invented", "tab:orange"), ("unseen", "black")):
        means = [part["quality"][f"{name}_share"]["mean"] or 0.0 for part in parts]
        axes.barh(range(len(parts)), means, left=left, color=colour, label=name)
        left = [start + mean for start, mean in zip(left, means, strict=True)]
    for place, part in enumerate(parts):
        missing = part["quality"]["observed_share"]["not_measured"]
        if missing:
            axes.text(left[place], place, f" {missing} not measured", va="center", fontsize=8)
    axes.set_yticks(range(len(parts)), [part["name"] for part in parts])
    axes.invert_yaxis()
    axes.set(title="pixels of all views", xlabel="share of pixels", xlim=(0, 1.18))
    axes.legend(fontsize=8, loc="lower right")
    axes.tick_params(labelsize=8)


def _draw_action_errors(axes: Any, mixture: Mixture) -> None:
    errors = mixture.samples["action_error"]
    known = errors.drop_nulls().sort()
    axes.set(title="action errors", ylabel="share of measured samples", ylim=(0, 1))
    axes.set_xlabel(f"metres; {errors.null_count()} of {len(errors)} samples not measured")
    axes.axvline(ROUND_TRIP_TOLERANCE, color="tab:red", lw=1, label=f"{ROUND_TRIP_TOLERANCE:g} m")
    if len(known):
        axes.ecdf(known.to_numpy())
    axes.legend(fontsize=8, loc="lower right")
    axes.grid(True, alpha=0.3)


def _draw_bars(axes: Any, shares: Mapping[str, float], notes: Sequence[str]) -> None:
    axes.barh(range(len(shares)), list(shares.values()), color="tab:blue")
    for place, (share, note) in enumerate(zip(shares.values(), notes, strict=True)):
        axes.text(share, place, f" {note}", va="center", fontsize=8)
    axes.set_yticks(range(len(shares)), list(shares))
    axes.invert_yaxis()
    axes.set(xlabel="share of items", xlim=(0, 1.18))
    axes.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0])
    axes.grid(True, axis="x", alpha=0.3)
    axes.tick_params(labelsize=8)
