"""Ids of clips, and what a store tells of how they were built."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from olt_toolkit.clips.build_options import describe_build, find_differences
from olt_toolkit.clips.estimators import DepthEstimator, Estimators, PoseEstimator
from olt_toolkit.clips.identity import clip_id_of
from olt_toolkit.clips.views import BuildOptions
from olt_toolkit.recordings.recording import OpenOptions
from olt_toolkit.rigs.contracts import find_contract
from olt_toolkit.rigs.names import FrontLens

WORDS = st.text(st.characters(exclude_categories=["Cc", "Cs"]))
SUBJECTS = st.tuples(
    WORDS,
    WORDS,
    st.tuples(st.integers(0, 10**9), st.integers(0, 10**9)),
    st.sampled_from(["GT", "Syn", "front_only"]),
    st.integers(0, 10**6),
)
OPTIONS = BuildOptions(width=96, height=54)


@given(first=SUBJECTS, second=SUBJECTS)
def test_clips_of_other_moments_scenes_kinds_and_seeds_have_other_ids(first, second):
    assert (clip_id_of(*first) == clip_id_of(*second)) == (first == second)


def test_front_lenses_give_two_clips_where_they_differ():
    ids = {kind: [clip_id_of("s", "", (0, 1), kind, 0, lens) for lens in FrontLens] for kind in ("GT", "Syn")}
    assert ids["GT"][0] == ids["GT"][1]
    assert ids["Syn"][0] != ids["Syn"][1]


def describe(options=OPTIONS, estimators=None, opening=None, takes_reference=False):
    return describe_build(options, estimators or Estimators(), opening or OpenOptions(), takes_reference)


def test_options_that_a_kind_does_not_use_are_not_told(tmp_path):
    depth = Estimators(depth=DepthEstimator.DEPTHANYTHING, depth_weights=tmp_path)
    assert describe() != describe(estimators=depth)
    true = replace(OPTIONS, use_reference_views=True)
    assert describe(true) == describe(true, depth) == describe(true, opening=OpenOptions(width=1000))
    assert json.loads(describe(true)).keys() == {"width", "height", "cameras", "frames", "samples"}
    # Asked for by name or taken because the data set has it: the motion is the same.
    reference = Estimators(poses=PoseEstimator.REFERENCE)
    assert describe(takes_reference=True) == describe(estimators=reference, takes_reference=True) != describe()
    assert describe() == json.dumps(json.loads(describe()), sort_keys=True)


def test_weights_are_told_by_their_files_and_not_by_their_folder(tmp_path):
    texts = []
    for name, content in (("here", b"12"), ("there", b"34"), ("other", b"567")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "model.safetensors").write_bytes(content)
        found = Estimators(depth=DepthEstimator.DEPTHANYTHING, depth_weights=Path(tmp_path / name))
        texts.append(describe(estimators=found))
    assert texts[0] == texts[1] != texts[2]


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"options": replace(OPTIONS, width=98)}, "--width 96 (now 98)"),
        ({"options": replace(OPTIONS, frames="all")}, "--all-frames (frames) grid (now all)"),
        ({"options": replace(OPTIONS, cameras=find_contract("alpamayo-2").cameras)}, "camera_rear_left_70fov"),
        ({"options": replace(OPTIONS, category="animal")}, "--category unlabelled (now animal)"),
        ({"options": replace(OPTIONS, factors=("rain",))}, "factors none (now rain)"),
        ({"options": replace(OPTIONS, split="test")}, "split train (now test)"),
        ({"options": replace(OPTIONS, sample_t0_us=(1_700_000,))}, "8 sample times that are not asked for now"),
        ({"takes_reference": True}, "--poses odometry (now reference)"),
        ({"opening": OpenOptions(horizontal_fov=1.0)}, "--fov not given (now 57.295779513)"),
        ({"opening": OpenOptions(camera_height=1.2)}, "--camera-height not given (now 1.2)"),
        ({"opening": OpenOptions(rotate=90)}, "--rotate 0 (now 90)"),
        ({"opening": OpenOptions(mirror=True)}, "--mirror False (now True)"),
    ],
)
def test_what_differs_is_named(changed, words, make_clip, tmp_path):
    options = changed.get("options", OPTIONS)
    found = store_info(make_clip, tmp_path, describe())
    (difference,) = find_differences(found, options, describe(**changed))
    assert words in difference
    assert find_differences(found, OPTIONS, describe()) == []


def test_a_clip_that_does_not_tell_how_it_was_built_is_not_taken_for_another(make_clip, tmp_path):
    assert find_differences(store_info(make_clip, tmp_path, None), OPTIONS, describe()) == [
        "options that it does not tell"
    ]


def store_info(make_clip, tmp_path, build_options):
    """The row of a clip, unlabelled, of 9 sample times from 1.7 s on."""
    from olt_toolkit.clips.store import ClipStore

    clip = replace(make_clip("bend"), category="unlabelled", factors=(), build_options=build_options)
    return ClipStore(tmp_path).prepare(clip)
