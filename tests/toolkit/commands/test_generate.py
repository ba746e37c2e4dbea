"""`olt generate describe`: what an engine takes, as tables and as JSON."""

import json

import pytest
from typer.testing import CliRunner

from olt_generator.errors import InputError
from olt_toolkit.commands.generate import app


def run(*arguments):
    result = CliRunner().invoke(app, ["describe", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0
    return result.stdout


SMALL = ("--config", "tiny", "--frames", 9, "--width", 64, "--height", 32)


def test_tables_tell_parameters_and_costs():
    shown = run(*SMALL)
    for said in ("LoRA, self-attention of VACE", "camera_rear_tele_30fov", "32 / 16", "not stated", "not measured"):
        assert said in shown


def test_only_what_is_wanted_is_counted():
    every = json.loads(run(*SMALL, "--json"))
    cross = json.loads(
        run(*SMALL, "--json", "--view", "camera_cross_left_120fov", "--view", "camera_cross_right_120fov")
    )
    assert len(every["views"]) == 5 and len(cross["views"]) == 2
    assert cross["views"] == every["views"][:2]
    assert len(cross["left_out"]) == 3
    assert cross["clip_flops"] < 0.5 * every["clip_flops"]
    rear = json.loads(run(*SMALL, "--json", "--view", "camera_rear_left_70fov"))
    assert [row["wanted"] for row in rear["views"]] == [False, True]


def test_guidance_doubles_the_passes_and_precision_halves_the_weights():
    two, one = (json.loads(run(*SMALL, "--json", *more)) for more in ((), ("--no-guidance", "--precision", "float32")))
    assert two["settings"]["passes"] == 100 and one["settings"]["passes"] == 50
    assert 1.8 < one["weights_bytes"] / two["weights_bytes"] < 2.0
    assert two["views"][0]["flops"] == pytest.approx(2 * one["views"][0]["flops"], rel=0.02)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--config", "14B"), "choose from 1.3B"),
        ((*SMALL, "--frames", 40), "to 37 or give 41"),
        ((*SMALL, "--height", 36), "do not fill tokens"),
        ((*SMALL, "--view", "front"), "choose from camera_cross_left"),
    ],
)
def test_what_cannot_be_described_is_refused(options, said):
    with pytest.raises(InputError, match=said):
        run(*options)
