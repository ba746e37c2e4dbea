"""A picture of the shares of a mixture."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from olt_datasets.mixtures.mixture import GROUPS, Mixture
from olt_generator.files import write_whole

MOST_BARS = 12
"""Values shown in one panel; the rarer ones are counted together."""


def draw_mixture(mixture: Mixture, path: Path) -> None:
    """Draw what each component was asked for and gave, and the shares by each group, as PNG.

    A curriculum adds the shares of the components over the epochs.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    summary = mixture.describe()
    figure, panels = pyplot.subplots(2, 3, figsize=(13, 7), layout="constrained")
    _draw_components(panels[0, 0], mixture, summary["components"])
    for axes, group in zip(panels.flat[1:], GROUPS, strict=True):
        _draw_shares(axes, summary[f"by_{group}"], max(len(mixture), 1))
        axes.set_title(f"by {group}" + (" (a sample has any number)" if group == "factors" else ""))
    figure.suptitle(f"{mixture.recipe.name}: {len(mixture)} samples per epoch, seed {mixture.seed}")
    with write_whole(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110, metadata={"Software": None})
    pyplot.close(figure)


def _draw_components(axes: Any, mixture: Mixture, parts: Sequence[Mapping[str, Any]]) -> None:
    epochs = mixture.recipe.named_epochs
    if len(epochs) > 1:
        _draw_curriculum(axes, mixture, range(epochs[-1] + 2))
        return
    places = range(len(parts))
    got = [part["got"] / len(mixture) for part in parts]
    axes.barh(places, got, color="tab:blue", label="got")
    axes.plot([part["asked"] / len(mixture) for part in parts], places, "k|", ms=22, mew=2, label="asked")
    for place, part, share in zip(places, parts, got, strict=True):
        axes.text(share, place, f" {part['got']} of {part['available']}", va="center", fontsize=8)
    axes.set_yticks(places, [part["name"] for part in parts])
    _finish(axes, "components")
    if parts:
        axes.legend(fontsize=8, loc="lower right")


def _draw_curriculum(axes: Any, mixture: Mixture, epochs: range) -> None:
    shares = [[count / len(mixture) for count in mixture.counts(epoch)] for epoch in epochs]
    names = [component.name for component in mixture.recipe.components]
    axes.stackplot(epochs, list(zip(*shares, strict=True)), labels=names, step="post", alpha=0.8)
    axes.set(title="components over epochs", xlabel="epoch", ylabel="share of items", ylim=(0, 1), xlim=(0, epochs[-1]))
    axes.legend(fontsize=8, loc="lower left")


def _draw_shares(axes: Any, groups: Mapping[str, Mapping[str, int]], items: int) -> None:
    by_size = sorted(groups.items(), key=lambda entry: (-entry[1]["got"], entry[0]))
    shown = {value: numbers["got"] for value, numbers in by_size[:MOST_BARS]}
    rest = by_size[MOST_BARS:]
    if rest:
        shown[f"{len(rest)} others"] = sum(numbers["got"] for _, numbers in rest)
    axes.barh(range(len(shown)), [got / items for got in shown.values()], color="tab:blue")
    for place, got in enumerate(shown.values()):
        axes.text(got / items, place, f" {got / items:.1%}", va="center", fontsize=8)
    axes.set_yticks(range(len(shown)), shown)
    _finish(axes, "")


def _finish(axes: Any, title: str) -> None:
    axes.invert_yaxis()
    axes.set(title=title, xlabel="share of items", xlim=(0, 1.18))
    axes.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0])
    axes.grid(True, axis="x", alpha=0.3)
    axes.tick_params(labelsize=8)
