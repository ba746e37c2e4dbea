"""`olt bench true_sight`: what the toy's choice of plans makes of a perfect sight, on the long-tail suite.

Whoever chooses is told of every cell what is true, in place of what the images show, and is given one plan: along the
route, at the speed of a free road. What is met then is the fault of the choice, and what is met beyond it that of the
sight.
"""

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from olt_generator.errors import InputError

if TYPE_CHECKING:
    from olt_closed_loop.scenes.scene import Scene
    from olt_generator.poses import Array
    from olt_toolkit.policy.contract import Observation, PlannedTrajectory

app = typer.Typer(add_completion=False)


@app.command()
def true_sight(
    events: Annotated[list[str] | None, typer.Argument(help="Events of the suite; all 53 where none is given.")] = None,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Drive the long-tail suite by the toy's choice of plans, with the truth in place of its sight."""
    from olt_closed_loop import run_closed_loop, summarize_scores
    from olt_closed_loop.commands.score_output import print_scores
    from olt_closed_loop.simulation.scene_policy import ScenePolicy
    from olt_closed_loop.suite.catalogue import CATEGORIES, EVENTS
    from olt_closed_loop.suite.scenes import PREFIX
    from olt_toolkit.runtime.console import print_json, print_line, show_progress
    from olt_toolkit.runtime.threads import use_one_thread

    use_one_thread()
    names = events or [name for name, entry in EVENTS.items() if entry.category in CATEGORIES]
    policy = ScenePolicy(TrueSightDriver.name, TrueSightDriver)
    with show_progress("closed loop") as (on_progress, _):
        results = run_closed_loop(
            [PREFIX + name for name in names], policy, rollouts=1, workers=workers, on_progress=on_progress
        )
    scores = [score for _, score in results]
    table = summarize_scores(scores)
    if as_json:
        print_json({"table": table.to_dict(), "scores": [score.to_dict() for score in scores]})
        return
    print_scores("true sight", table)
    for score in scores:
        if score.collided or score.offroad:
            print_line(f"{score.scene}: {'collided' if score.collided else 'left the road'}")


class TrueSightDriver:
    """Drives one rollout of one scene."""

    name = "true_sight"
    cameras: tuple[str, ...] = ()
    image_size: tuple[int, int] = (0, 0)

    def __init__(self, scene: "Scene") -> None:
        from olt_closed_loop.privileged.labels import label_road
        from olt_sft_recipes.toy.patience import Patience
        from olt_toolkit.policy.route import PathTracker

        self._scene, self._reckoning, self._patience = scene, None, Patience()
        road = label_road(_standing(scene, 0, np.eye(4)), 0)
        if road is None:
            raise InputError(f"policy {self.name}: scene {scene.name} gives no route or no road; choose another scene")
        self._road = PathTracker(road)

    def plan(self, observation: "Observation") -> "PlannedTrajectory":
        """See `Policy.plan`."""
        from olt_closed_loop.privileged.driver import reckon
        from olt_generator.poses import planar_pose
        from olt_sft_recipes.toy.inputs import cells_along, pad_route, planar_poses
        from olt_sft_recipes.toy.occupancy import Occupancy
        from olt_sft_recipes.toy.plan_choice import CRUISE, choose_plan
        from olt_sft_recipes.toy.route_line import RouteLine
        from olt_sft_recipes.toy.tried_paths import LONG, path_aside
        from olt_toolkit.policy.action_space import estimate_initial_speed
        from olt_toolkit.policy.contract import FUTURE_STEPS, STEP_SECONDS, PlannedTrajectory

        begins = self._reckoning is None
        self._reckoning = reckon(self._scene, self._reckoning, observation)
        if begins:
            self._road.start_at(self._reckoning.T_frame_rig[:2, 3])
        history = planar_poses(observation.history_xyz, observation.history_rotation)[None]
        along = cells_along(history, pad_route(observation.route_xy)[None])[0]
        line = RouteLine.of(along)
        speed = max(float(estimate_initial_speed(observation.history_xyz, observation.history_rotation)), 0.0)
        ways = STEP_SECONDS * np.arange(1.0, FUTURE_STEPS + 1) * max(speed, min(CRUISE, line.bend_speed))
        free = path_aside(line, 0.0, LONG, speed).poses_at(ways)
        occupancy = Occupancy.of_truth(self._truth(self._reckoning.T_frame_rig, observation.time_us, along), line)
        x, y, yaw = choose_plan(free[None], speed, occupancy, self._patience.way_worth(observation.time_us, speed)).T
        planned = planar_pose(x, y, yaw)
        return PlannedTrajectory(planned[:, :3, 3], planned[:, :3, :3])

    def _truth(self, T_world_rig: "Array", time_us: int, along: "Array") -> NDArray[np.uint8]:
        """What is true of the cells, seen from a pose."""
        from olt_closed_loop.privileged.labels import label_holds, label_obstacles
        from olt_generator.poses import yaw_of
        from olt_sft_recipes.toy.image_encoder import SECONDS_AHEAD
        from olt_sft_recipes.training.auxiliary import others_truth, road_truth
        from olt_toolkit.policy.route import route_ahead

        standing = _standing(self._scene, time_us, T_world_rig)
        tracks, holds = label_obstacles(standing, time_us), label_holds(standing, time_us)
        told = [tracks.timestamps_us == round(1e6 * seconds) for seconds in SECONDS_AHEAD]
        boxes = np.full((len(told), max(int(rows.sum()) for rows in told), 5), np.nan)
        for second, rows in enumerate(told):
            boxes[second, : rows.sum()] = tracks.boxes[rows][:, [0, 1, 3, 4, 5]]
        hold = np.array([float(holds.is_held[0]), holds.distance[0]])
        x, y = T_world_rig[:2, 3].tolist()
        road = route_ahead(self._road, x, y, float(yaw_of(T_world_rig)))
        return np.concatenate([others_truth(along, boxes, hold), road_truth(road)[None]])


def _standing(scene: "Scene", time_us: int, T_world_rig: "Array") -> "Scene":
    """The scene as if the vehicle stood at a pose from a time on."""
    from olt_generator.trajectory import Trajectory
    from olt_sft_recipes.toy.image_encoder import SECONDS_AHEAD

    times = np.array([time_us, time_us + round(1e6 * SECONDS_AHEAD[-1])], dtype=np.int64)
    return replace(scene, ego=Trajectory(times, np.stack([T_world_rig, T_world_rig])))
