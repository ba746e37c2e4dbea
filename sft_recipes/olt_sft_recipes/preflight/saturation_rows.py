"""How many future tokens stand for the end of their range, where what was driven lies beyond it.

The recipe cuts off in silence: braking beyond 6.78 m/s², turns beyond 0.26 1/m (docs/formats/alpamayo.md).
"""

import time

import numpy as np

from olt_generator.errors import InputError
from olt_sft_recipes.preflight.plan import PreflightPlan
from olt_sft_recipes.preflight.recipe_folder import RecipeFolder
from olt_sft_recipes.preflight.rows import Row, RowMaker
from olt_sft_recipes.toy.tokens import FUTURE_TOKENS, encode_actions
from olt_toolkit.policy.action_space import trajectory_to_actions
from olt_toolkit.rigs.names import ContractName

ROWS = RowMaker("data")


def saturation_row(
    folder: RecipeFolder, part: str, clip_ids: list[str], of: int, plan: PreflightPlan, deadline: float
) -> Row:
    """Saturated tokens of the samples of these clips, of `of` that are selected; the rest when time is up."""
    check, looked, touched, tokens, first = f"{part} saturated tokens", 0, 0, 0, ""
    for clip_id in clip_ids:
        if looked and time.monotonic() > deadline:
            break
        try:
            saturated = _count(folder, clip_id, plan)
        except InputError:
            continue  # the row of the clips tells
        looked, touched, tokens = looked + 1, touched + bool(saturated), tokens + saturated
        first = first or (clip_id if saturated else "")
    if not looked:
        return ROWS.not_checked(check, folder.root, "no sample could be read")
    share = tokens / (looked * FUTURE_TOKENS)
    found = f"{tokens} of {looked * FUTURE_TOKENS} ({share:.2%}), in {touched} of {looked} samples of {of}"
    if not tokens:
        return ROWS.passed(check, folder.root, found)
    found += f", first in clip {first}: weaker braking or wider turns than were driven are learned"
    action = f"look at the ego motion of {first}, or take such clips out"
    if share > plan.most_saturated:
        return ROWS.failed(check, folder.root, f"{found}; at most {plan.most_saturated:.2%} is allowed", action)
    return ROWS.note(check, folder.root, found, action)


def _count(folder: RecipeFolder, clip_id: str, plan: PreflightPlan) -> int:
    t0_us = folder.t0_us(clip_id, plan.use_default_keyframe)
    history, future = folder.ego_motion(clip_id).around(np.array([t0_us], np.int64))
    poses = history[..., :3, 3], history[..., :3, :3], future[..., :3, 3], future[..., :3, :3]
    return encode_actions(trajectory_to_actions(*poses, ContractName(plan.policy)))[1]
