"""Scores in print."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from olt_closed_loop.evaluation.comparison import Comparison
    from olt_closed_loop.evaluation.score_table import ScoreRow, ScoreTable
    from olt_closed_loop.evaluation.suite_table import SuiteTable
    from olt_closed_loop.scoring.definitions import RolloutScore
    from olt_generator.omissions import Omission

INCIDENT_WORDS = {
    "plans_refused": "a plan was refused and the last one held",
    "plans_out_of_reach": "a plan was beyond what any tyres can hold",
    "policy_errors": "the policy raised an error",
    "policy_exits": "the policy called for an exit",
    "policy_deaths": "the policy's process died",
    "policy_timeouts": "the policy gave no answer in time",
    "wrong_answers": "the policy answered with something else than a plan",
    "inputs_changed": "the policy changed what it was shown",
    "globals_changed": "the policy changed global states",
    "steps_failed": "the vehicle could not follow a plan",
    "saturations": "a command reached a limit of the vehicle",
    "solves_failed": "the controller found no command and held the last ones",
    "solves_late": "the controller was late and held the last commands",
    "solves_given_up": "fatrop gave up and Gauss-Newton was asked",
}
"""What those counts of `rollouts.rollout.Incidents` that are no good news are called in print."""


def print_scores(title: str, table: "ScoreTable") -> None:
    """A row a category, and one of all."""
    from olt_toolkit.runtime.console import print_table, word_interval

    rows = [
        [
            row.category,
            f"{row.valid} / {row.rollouts}",
            row.alpasim_score,
            word_interval(row.alpasim_score_interval),
            row.collision_rate,
            word_interval(row.collision_rate_interval),
            f"{counts['solves_failed']} / {counts['solves_late']}" if (counts := row.rollout_incidents) else None,
        ]
        for row in table.rows
    ]
    columns = ["category", "valid / rollouts", "AS", "95 %", "CR", "95 %", "solves failed / late"]
    print_table(f"{title}, definition {table.definition}", columns, rows)


def print_suite(table: "SuiteTable") -> None:
    """Scores by factor, and by the weights of the scenes."""
    from olt_closed_loop.evaluation.score_table import ScoreTable
    from olt_toolkit.runtime.console import print_line

    if table.factors:
        print_scores(f"{table.suite} by factor", ScoreTable(table.categories.definition, table.factors))
    score, rate = (
        "not measured" if value is None else f"{value:.3f}"
        for value in (table.weighted_score, table.weighted_collision_rate)
    )
    print_line(f"suite {table.suite}, by the weights of its scenes: AS {score}, CR {rate}")


def print_comparison(title: str, comparison: "Comparison") -> None:
    """Policies beside each other, and their differences."""
    from olt_closed_loop.evaluation import comparison_report as report
    from olt_toolkit.runtime.console import print_table

    print_table(f"{title}: {comparison.scenes}", report.POLICY_COLUMNS, report.policy_rows(comparison))
    if comparison.differences:
        rows = report.difference_rows(comparison.differences)
        print_table("Paired by scene", report.DIFFERENCE_COLUMNS, rows)


def print_notes(
    scores: "list[RolloutScore]",
    overall: "ScoreRow",
    vehicle_steps: dict[str, int],
    left_out: "dict[Omission, int]",
) -> None:
    """What was not valid, went wrong, was taken and was left out, a line each."""
    from olt_generator.omissions import word_omission
    from olt_toolkit.runtime.console import print_line

    for line in sorted({f"{score.scene}: not valid: {score.reason}" for score in scores if not score.valid}):
        print_line(line)
    for name, count in overall.rollout_incidents.items():
        if count and name in INCIDENT_WORDS:
            print_line(f"{INCIDENT_WORDS[name]}: {count} times")
    if overall.plan_deviation_max is not None:
        print_line(f"the vehicle was at most {overall.plan_deviation_max:.2f} m from the plan within the second ahead")
    for way, count in vehicle_steps.items():
        print_line(f"vehicle moved by {way} in {count} steps")
    for omission, count in left_out.items():
        print_line(f"left out in {count} of {len(scores)} rollouts: {word_omission(omission)}")
