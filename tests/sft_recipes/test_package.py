import subprocess
import sys

import pytest

import olt_sft_recipes


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, olt_sft_recipes; print([name for name in ('torch', 'casadi', 'pxr') if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_the_package_gives_its_names():
    assert callable(olt_sft_recipes.train_on_mixture) and callable(olt_sft_recipes.evaluate_open_loop)
    assert "run_demo" in dir(olt_sft_recipes)
    with pytest.raises(AttributeError, match="no attribute 'absent'"):
        olt_sft_recipes.absent  # noqa: B018 - the access itself is what is tested
