import numpy as np
import pytest

from olt_closed_loop.benchmarks import control_extremes
from olt_closed_loop.benchmarks.alpasim_vehicle import alpasim_vehicle, drive_step
from olt_closed_loop.benchmarks.control import BENCHMARK, WITH_TYRES, track, tracking_figures
from olt_closed_loop.benchmarks.control_references import alpasim_references
from olt_closed_loop.control.tracking import ControlSettings
from olt_closed_loop.vehicle.integrators import VehicleStepper

CASES = {case.name: case for case in control_extremes.cases(0.9)}


def test_there_are_120_references_of_which_70_differ():
    references = list(alpasim_references())
    assert len(references) == 70 and sum(reference.copies for reference in references) == 120
    assert len({reference.poses.tobytes() for reference in references}) == 70
    for reference in references:
        first = np.linalg.norm(reference.poses[1, :2] - reference.poses[0, :2]) / 0.1
        assert first == pytest.approx(reference.speed, abs=0.01)


def test_the_vehicle_of_the_benchmark_drives_as_ours_does_with_its_parameters():
    theirs = np.array([[0.0, 0.0, 0.0, 20.0, 0.0, 0.0, 0.0, 0.0]])
    ours, stepper = np.array([0.0, 0.0, 0.0, 20.0, 0.0, 0.0, 0.0, 0.0]), VehicleStepper(WITH_TYRES, "rk4", 20)
    control = np.array([0.01, 0.5])
    for _ in range(20):
        theirs, ours = drive_step(theirs, control[None], 0.1), np.array(stepper(ours, control))
    np.testing.assert_allclose(ours[:3], theirs[0, :3], atol=0.1)
    assert theirs[0, 1] > 1.0


def test_references_of_every_kind_are_tracked_within_the_aim():
    tracking = track(list(alpasim_references())[9::12], WITH_TYRES, ControlSettings())
    assert tracking.failed == 0
    assert tracking.rms < 0.05
    figures = tracking_figures(tracking)
    assert figures["largest error (m)"] == tracking.errors.max() < 0.2
    assert 0.0 < figures["call, median (ms)"] <= figures["call, p99 (ms)"]


def test_one_setting_is_the_default():
    assert [setting.name for setting in BENCHMARK.settings() if setting.default] == ["linear MPC, 1 s ahead"]


@pytest.mark.parametrize("speed", control_extremes.SPEEDS[1:])
def test_curves_are_tracked_at_every_speed(speed):
    driven = control_extremes.drive(CASES[f"curve at {speed:g} m/s"], WITH_TYRES, "linear")
    assert driven.outcome == "tracked"
    assert driven.errors.max() < 0.1


@pytest.mark.parametrize("friction", [0.05, 0.3])
@pytest.mark.parametrize(
    "name", ["curve at 60 m/s", "15 m/s to rest", "backwards from the forward gear", "forwards and back"]
)
def test_slippery_roads_are_driven(friction, name):
    case = next(case for case in control_extremes.cases(friction) if case.name == name)
    driven = control_extremes.drive(case, alpasim_vehicle(friction), "linear")
    assert driven.outcome == "tracked"


def test_a_curve_that_no_tyre_holds_is_left_without_a_failure():
    driven = control_extremes.drive(CASES["curve beyond the grip at 15 m/s"], alpasim_vehicle(0.3), "linear")
    assert driven.outcome == "off the plan" and driven.counts.failed == 0
    assert np.isfinite(driven.errors).all()


@pytest.mark.parametrize("speed", [5.0, 30.0, 60.0])
def test_a_plan_that_jumps_sideways_is_met_again(speed):
    driven = control_extremes.drive(CASES[f"jump of 1 m at {speed:g} m/s"], WITH_TYRES, "linear")
    assert driven.errors.max() == pytest.approx(1.0, abs=0.05)
    assert driven.errors[-1] < 0.02


@pytest.mark.parametrize(
    ("case", "limit"),
    [("reversing at 3 m/s", 0.02), ("plans 1 s old", 0.05), ("standstill, then 5 m/s", 0.5)],
)
def test_unusual_plans_are_tracked(case, limit):
    assert control_extremes.drive(CASES[case], WITH_TYRES, "linear").errors.max() < limit


def test_at_the_end_of_a_plan_the_vehicle_stands():
    driven = control_extremes.drive(CASES["the plan ends after 3 s"], WITH_TYRES, "linear")
    assert np.ptp(driven.errors[-10:]) < 1e-3
    assert driven.errors[-1] < 2.0


@pytest.mark.parametrize(("case", "failed", "late"), [("every solve late", 0, 80), ("every solve of 1 s fails", 10, 0)])
def test_failed_and_late_solves_are_counted_and_what_is_held_stays_on_the_plan(case, failed, late):
    driven = control_extremes.drive(CASES[case], WITH_TYRES, "linear")
    assert (driven.counts.failed, driven.counts.late) == (failed, late)
    assert driven.outcome == "held" and driven.errors.max() < 0.1


@pytest.mark.slow
def test_every_possible_case_is_tracked_on_a_dry_road():
    grid = control_extremes.control_grid()
    missed = {row["case"] for row in grid.rows if row["possible"] and row["outcome"] == "off the plan"}
    # A slow vehicle has no room to get sideways within the eight seconds; ice gives no room to correct either.
    assert {name for name in missed if not name.startswith("jump")} == set()
    assert len(grid.summary) == 1 + len(control_extremes.WAYS)


@pytest.mark.parametrize(
    ("case", "reason"),
    [("NaN in the plan", "finite"), ("NaN in the state", "finite"), ("a plan at 75 m/s", "at most 65 m/s")],
)
def test_plans_that_cannot_be_driven_are_refused_in_words(case, reason):
    assert reason in control_extremes.drive(CASES[case], WITH_TYRES, "linear").refused
