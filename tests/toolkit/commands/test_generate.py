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


SMALL = ("--config", "tiny", "--frames", 5, "--width", 32, "--height", 16)


@pytest.fixture(scope="module")
def every():
    return json.loads(run(*SMALL, "--json"))


def test_all_views_are_counted(every):
    assert [row["conditions"] for row in every["views"]] == [1, 1, 2, 2, 3]
    assert all(row["wanted"] for row in every["views"])
    assert not every["left_out"]
    assert every["seconds"] is None
    coding = 6 * every["encode_flops"] + 5 * every["decode_flops"]
    assert every["clip_flops"] == coding + sum(row["flops"] for row in every["views"])


def test_tables_tell_what_is_wanted_and_what_is_left_out():
    shown = run(*SMALL, "--view", "camera_cross_left_120fov")
    for said in ("LoRA, self-attention of VACE", "32 / 16", "not stated", "not measured"):
        assert said in shown
    assert "left out: camera_rear_tele_30fov: no wanted view depends on it" in shown


def test_without_guidance_in_single_precision(every):
    """Half the passes, twice the weights; and a rear view alone brings the cross view that it depends on."""
    one = json.loads(
        run(*SMALL, "--json", "--no-guidance", "--precision", "float32", "--view", "camera_rear_left_70fov")
    )
    assert [row["wanted"] for row in one["views"]] == [False, True]
    assert one["settings"]["passes"] == 50 and every["settings"]["passes"] == 100
    assert 1.8 < one["weights_bytes"] / every["weights_bytes"] < 2.0
    assert every["views"][0]["flops"] == pytest.approx(2 * one["views"][0]["flops"], rel=0.02)


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
