"""Rigs, clips, four-camera inputs, the policy contract, and the frame of the command line, reports and benchmarks.

What a user of the package needs is here by name, and loaded when it is first asked for.
"""

from typing import TYPE_CHECKING

from olt_generator.lazy_names import lazy_names
from olt_generator.version import __version__ as __version__

if TYPE_CHECKING:
    from olt_toolkit.clips.builder import BuiltClip as BuiltClip
    from olt_toolkit.clips.builder import build_clip as build_clip
    from olt_toolkit.clips.clip import CameraStream as CameraStream
    from olt_toolkit.clips.clip import Clip as Clip
    from olt_toolkit.clips.clip import ClipInfo as ClipInfo
    from olt_toolkit.clips.clip import EgoMotion as EgoMotion
    from olt_toolkit.clips.store import ClipStore as ClipStore
    from olt_toolkit.clips.views import BuildOptions as BuildOptions
    from olt_toolkit.policy.action_space import actions_to_trajectory as actions_to_trajectory
    from olt_toolkit.policy.action_space import trajectory_to_actions as trajectory_to_actions
    from olt_toolkit.policy.contract import Observation as Observation
    from olt_toolkit.policy.contract import PlannedTrajectory as PlannedTrajectory
    from olt_toolkit.policy.contract import Policy as Policy
    from olt_toolkit.policy.sample import PolicySample as PolicySample
    from olt_toolkit.policy.sample import SampleKey as SampleKey
    from olt_toolkit.recordings.drives import Dataset as Dataset
    from olt_toolkit.recordings.drives import DatasetPlace as DatasetPlace
    from olt_toolkit.recordings.drives import DatasetReader as DatasetReader
    from olt_toolkit.recordings.drives import Drive as Drive
    from olt_toolkit.recordings.drives import Licence as Licence
    from olt_toolkit.recordings.drives import open_dataset as open_dataset
    from olt_toolkit.recordings.drives import open_recording as open_recording
    from olt_toolkit.recordings.recording import OpenOptions as OpenOptions
    from olt_toolkit.recordings.recording import Recording as Recording
    from olt_toolkit.rigs.rig import Rig as Rig
    from olt_toolkit.rigs.rig_files import load_rig as load_rig
    from olt_toolkit.rigs.rig_files import read_rig as read_rig

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "clips.builder": ("BuiltClip", "build_clip"),
        "clips.clip": ("CameraStream", "Clip", "ClipInfo", "EgoMotion"),
        "clips.store": ("ClipStore",),
        "clips.views": ("BuildOptions",),
        "policy.action_space": ("actions_to_trajectory", "trajectory_to_actions"),
        "policy.contract": ("Observation", "PlannedTrajectory", "Policy"),
        "policy.sample": ("PolicySample", "SampleKey"),
        "recordings.drives": (
            "Dataset",
            "DatasetPlace",
            "DatasetReader",
            "Drive",
            "Licence",
            "open_dataset",
            "open_recording",
        ),
        "recordings.recording": ("OpenOptions", "Recording"),
        "rigs.rig": ("Rig",),
        "rigs.rig_files": ("load_rig", "read_rig"),
    },
)
