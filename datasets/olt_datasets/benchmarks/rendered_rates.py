"""Plants faults that only images show into rendered clips, and counts what verification says of both."""

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from olt_datasets.benchmarks.fault_rates import Outcome, StoreMeasure, tell_outcome, word_alarms
from olt_datasets.benchmarks.image_faults import IMAGE_FAULTS, ImageFault
from olt_datasets.benchmarks.rendered_clips import write_rendered_store
from olt_generator.seeds import make_generator
from olt_toolkit.clips.store import ClipStore
from olt_toolkit.clips.verification.clip_evidence import ClipEvidence, gather_evidence
from olt_toolkit.clips.verification.decoded_videos import ClipVideos
from olt_toolkit.clips.verification.image_checks import check_images
from olt_toolkit.clips.verification.neighbour_checks import check_neighbours, with_neighbours
from olt_toolkit.runtime.threads import use_one_thread


def measure_rendered_store(number: int, seed: int, faults: Sequence[str]) -> list[StoreMeasure]:
    """Render two good clips, look at each, and plant each of the faults into each, with the other one to swap with."""
    use_one_thread()
    with tempfile.TemporaryDirectory(prefix="verify.") as folder:
        return measure_good_store(write_rendered_store(Path(folder) / "good", number, seed), seed, faults)


def measure_good_store(store: ClipStore, seed: int, faults: Sequence[str]) -> list[StoreMeasure]:
    """The same of a store of two good clips that is there."""
    first, second = (info.clip_id for info in store.clips())
    videos = {clip_id: ClipVideos(store, clip_id) for clip_id in (first, second)}
    clips = {
        clip_id: gather_evidence(store, clip_id, list(store.info(clip_id).views), videos[clip_id]) for clip_id in videos
    }
    measures = []
    for clip_id, other in ((first, second), (second, first)):
        start = time.process_time()
        findings = list(check_images(store, clip_id, videos[clip_id]))
        seconds = time.process_time() - start
        outcomes: dict[str, Outcome] = {
            fault.name: _plant(fault, clips[clip_id], clips[other], seed)
            for fault in IMAGE_FAULTS
            if fault.name in faults
        }
        verdicts = [each.verdict for each in findings]
        measures.append(StoreMeasure(outcomes, verdicts, word_alarms(findings), {"images": seconds}, 1))
    return measures


def _plant(fault: ImageFault, clip: ClipEvidence, other: ClipEvidence, seed: int) -> Outcome:
    bad = fault.plant(clip, other, make_generator("planted faults", seed, clip.clip_id, fault.name))
    bad = with_neighbours(bad, list(check_neighbours(bad)))
    return tell_outcome([finding for look in fault.looks for finding in look(bad)])
