"""The preflight: every check of a launch in one call (`olt sft preflight`, and part of `olt sft launch`)."""

import time
from collections.abc import Iterator

from olt_sft_recipes.preflight.checkpoint_rows import checkpoint_rows
from olt_sft_recipes.preflight.data_rows import data_rows
from olt_sft_recipes.preflight.licence_rows import licence_rows
from olt_sft_recipes.preflight.machine_rows import disk_row, memory_rows, model_sizes
from olt_sft_recipes.preflight.names import PolicyName
from olt_sft_recipes.preflight.plan import PreflightPlan
from olt_sft_recipes.preflight.rows import PreflightReport, Row
from olt_sft_recipes.preflight.step_rows import step_rows, total_steps
from olt_sft_recipes.preflight.toy_rows import toy_data, toy_disk_row, toy_memory_rows
from olt_sft_recipes.preflight.verified_rows import verified_row
from olt_sft_recipes.preflight.version_rows import own_version_rows, version_rows


def check(plan: PreflightPlan) -> PreflightReport:
    """Look at everything that a launch would use; nothing is written and no network is used.

    A check that does not hold, or that cannot be made, is a row and no error.
    """
    start = time.perf_counter()
    rows = tuple(_toy_rows(plan) if plan.policy == PolicyName.TOY else _alpamayo_rows(plan))
    return PreflightReport(rows, time.perf_counter() - start)


def _alpamayo_rows(plan: PreflightPlan) -> Iterator[Row]:
    rows, samples = data_rows(plan)
    yield from rows
    yield verified_row(plan)
    rows, base = checkpoint_rows(plan)
    yield from rows
    config = {} if base is None else base.config
    yield from version_rows(plan, str(config.get("attn_implementation", "flash_attention_2")))
    sizes = model_sizes(plan, base)
    yield disk_row(plan, sizes, total_steps(plan, samples))
    yield from memory_rows(plan, sizes)
    yield from step_rows(plan, samples)
    yield from licence_rows(plan)


def _toy_rows(plan: PreflightPlan) -> Iterator[Row]:
    data = toy_data(plan)
    yield from data.rows
    yield verified_row(plan)
    yield from own_version_rows()
    yield toy_disk_row(plan, data.samples)
    yield from toy_memory_rows()
    yield from step_rows(plan, data.items)
    yield from licence_rows(plan)
