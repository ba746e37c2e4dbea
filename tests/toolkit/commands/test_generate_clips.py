"""`olt generate clips`: a video becomes a clip with generated views, once, and resumed where it was ended."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from olt_generator.diffusion import generated_views
from olt_generator.errors import InputError
from olt_generator.seeds import make_generator
from olt_generator.video import write_video
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.commands.generate import app

from ...generator.diffusion.tiny_engine import write_engine

QUICK = ("--steps", 1, "--guidance", 1, "--width", 96, "--height", 54, "--json")


def run(*arguments):
    result = CliRunner().invoke(app, ["clips", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return json.loads(result.stdout)


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """An engine, and a folder of one video of a standing vehicle."""
    folder = tmp_path_factory.mktemp("given")
    picture = make_generator("bridge").integers(0, 256, (54, 96, 3)).astype(np.uint8)
    write_video(folder / "videos" / "bridge.mp4", np.repeat(picture[None], 6, axis=0), 10.0)
    return write_engine(folder / "engine"), folder / "videos"


def files_of(store):
    return {str(path.relative_to(store)): path.read_bytes() for path in sorted(store.rglob("*")) if path.is_file()}


class Killed(Exception):
    """The run ends here."""


def test_a_run_that_ended_goes_on_and_leaves_the_same_bytes(given, tmp_path, monkeypatch):
    engine, videos = given
    asked = ("--generator-weights", engine, "--views", "rear_left", *QUICK)
    whole = run(videos, "--out", tmp_path / "whole", *asked)["recordings"][0]
    assert whole["state"] == "built"
    info = ClipStore(tmp_path / "whole").info(whole["clip_id"])
    kinds = {name: view.kind for name, view in info.views.items()}
    assert kinds == {"camera_front_wide_120fov": "observed", "camera_rear_left_70fov": "generated"}

    sampled, sample = [], generated_views.sample_view

    def die(engine, view, *arguments):
        if view == 3:
            raise Killed
        sampled.append(view)
        return sample(engine, view, *arguments)

    monkeypatch.setattr(generated_views, "sample_view", die)
    with pytest.raises(Killed):
        run(videos, "--out", tmp_path / "resumed", *asked)
    count = len(sampled)
    assert set(sampled) == {1}

    def go_on(engine, view, *arguments):
        sampled.append(view)
        return sample(engine, view, *arguments)

    monkeypatch.setattr(generated_views, "sample_view", go_on)
    run(videos, "--out", tmp_path / "resumed", *asked)
    assert set(sampled[count:]) == {3}
    assert files_of(tmp_path / "resumed") == files_of(tmp_path / "whole")
    assert not (tmp_path / "resumed" / ".generated").exists()

    assert run(videos, "--out", tmp_path / "whole", *asked)["recordings"][0]["state"] == "found"
    with pytest.raises(InputError, match="--steps 1"):
        run(videos, "--out", tmp_path / "whole", *asked, "--steps", 2)


def test_the_learned_engine_needs_weights(given, tmp_path):
    with pytest.raises(InputError, match="no such file"):
        run(given[1], "--out", tmp_path, "--generator-weights", tmp_path / "nothing", *QUICK)
    with pytest.raises(InputError, match="is of --backend wan-vace"):
        run(given[1], "--out", tmp_path, *QUICK)
