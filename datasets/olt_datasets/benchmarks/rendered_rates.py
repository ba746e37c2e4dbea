"""Plants faults that only images show into rendered clips, and counts what verification says of both."""

from collections.abc import Sequence

from olt_datasets.benchmarks.fault_rates import FaultBench, StoreMeasure, measure_store
from olt_datasets.benchmarks.image_faults import IMAGE_FAULTS, IMAGES
from olt_datasets.benchmarks.rendered_clips import write_rendered_store

IMAGE_BENCH = FaultBench(write_rendered_store, IMAGE_FAULTS, IMAGES)


def measure_rendered_store(number: int, seed: int, faults: Sequence[str]) -> StoreMeasure:
    """Render a store of two good clips, look at it, and plant each of the faults into a copy of its own."""
    return measure_store(number, seed, faults, IMAGE_BENCH)
