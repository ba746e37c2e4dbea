"""What importing the package loads."""

import subprocess
import sys

import pytest

import olt_closed_loop

HEAVY = ("casadi", "torch", "kornia", "pxr", "matplotlib", "pandas")
PROGRAM = """
import importlib, pkgutil, sys
for name in sys.argv[1].split(","):
    package = importlib.import_module(name)
    for module in pkgutil.walk_packages(package.__path__, f"{name}."):
        importlib.import_module(module.name)
print(*(name for name in sys.argv[2].split(",") if name in sys.modules))
"""


def loaded_by(*packages):
    command = [sys.executable, "-c", PROGRAM, ",".join(packages), ",".join(HEAVY)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()


def test_scoring_loads_nothing_heavy():
    assert loaded_by("olt_closed_loop.scoring", "olt_closed_loop.rollouts") == []


def test_the_package_itself_loads_nothing():
    program = "import olt_closed_loop, sys; print('numpy' in sys.modules)"
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert ran.stdout.split() == ["False"]


NAMES = (
    *("ControlSettings", "Rollout", "RolloutScore", "Scene", "SimulationSettings", "check_gate", "count_left_out"),
    *(
        "generate_scene",
        "pass_gate",
        "load_rollouts",
        "load_scene",
        "make_policy",
        "read_rollout_file",
        "read_scene",
        "replay",
        "run_closed_loop",
    ),
    *("compare_scores", "run_baselines"),
    *("CameraEffects", "Conditions", "list_hard_clips", "make_clip"),
    *("save_results", "save_rollouts", "score_record", "score_rollout", "simulate", "summarize_scores", "write_scene"),
)


@pytest.mark.parametrize("name", NAMES)
def test_the_package_gives_what_it_names(name):
    assert getattr(olt_closed_loop, name).__name__ == name
    assert name in dir(olt_closed_loop)


def test_what_the_package_does_not_have_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = olt_closed_loop.nothing
