"""A folder of videos built by several processes."""

from pathlib import Path

import numpy as np
import pytest

from olt_generator.seeds import make_generator
from olt_generator.video import write_video
from olt_toolkit.clips.build_job import BuildJob, BuildResult, build_clips
from olt_toolkit.clips.views import BuildOptions
from olt_toolkit.recordings.drives import find_drives
from olt_toolkit.runtime.workers import Engine


@pytest.fixture
def videos(tmp_path) -> Path:
    folder = tmp_path / "videos"
    for name in ("bridge", "alley"):
        picture = make_generator(name).integers(0, 256, (54, 96, 3)).astype(np.uint8)
        write_video(folder / f"{name}.mp4", np.repeat(picture[None], 12, axis=0), 10.0)
    return folder


def build(videos: Path, store: Path, workers: int, engine: Engine = Engine.LOCAL) -> list[BuildResult]:
    options = BuildOptions(width=96, height=54)
    jobs = [BuildJob(place, key, store, options=options) for place, key in find_drives(videos)]
    return build_clips(jobs, workers, engine=engine)


def files_of(store: Path) -> dict[str, bytes]:
    return {str(path.relative_to(store)): path.read_bytes() for path in sorted(store.rglob("*")) if path.is_file()}


@pytest.mark.slow
def test_the_number_of_processes_changes_nothing(videos, tmp_path):
    alone = build(videos, tmp_path / "alone", 1)
    together = build(videos, tmp_path / "together", 2)
    assert [outcome.path.stem for outcome in together] == ["alley", "bridge"]
    assert {outcome.state for outcome in alone + together} == {"built"}
    assert files_of(tmp_path / "alone") == files_of(tmp_path / "together")


@pytest.mark.slow
def test_a_ray_cluster_changes_nothing(videos, tmp_path):
    pytest.importorskip("ray", reason="needs the extra `distributed`")
    build(videos, tmp_path / "here", 1)
    build(videos, tmp_path / "cluster", 2, Engine.RAY)
    assert files_of(tmp_path / "here") == files_of(tmp_path / "cluster")


def test_recordings_are_found_by_name_and_nothing_else_is(videos):
    (videos / "notes.txt").write_text("")
    (videos / ".hidden.mp4").write_bytes(b"")
    assert [place.path.name for place, _ in find_drives(videos)] == ["alley.mp4", "bridge.mp4"]
