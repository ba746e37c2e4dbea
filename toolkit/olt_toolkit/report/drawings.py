"""Line drawings for report pages, as SVG text."""

import io
from collections.abc import Sequence

import numpy as np


def draw_losses(curves: Sequence[tuple[str, Sequence[float]]], title: str) -> str:
    """Training losses over steps, one named curve each."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(5, 3.2), layout="constrained")
    for label, losses in curves:
        axes.plot(np.arange(1, len(losses) + 1), losses, lw=1.2, label=label)
    axes.set(title=title, xlabel="step", ylabel="loss")
    axes.grid(True, alpha=0.3)
    axes.legend(fontsize=8)
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    pyplot.close(figure)
    return text.getvalue()
