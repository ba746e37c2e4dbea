"""Mutations of valid files, and a process of its own in which they are read.

A crash of native code, a hang, or an endless appetite for memory ends that process and not the tests. What a reader may
do with a damaged file is to read it or to raise an `InputError`; everything else is a fault of the reader.

Run as a program, this file is that process: it takes lines of JSON and answers each with one.
"""

import gzip
import io
import json
import os
import re
import resource
import select
import subprocess
import sys
import tempfile
import time
import warnings
import zipfile
from pathlib import Path

MOST_CPU_SECONDS = 5.0
MOST_SECONDS = 60.0  # of the clock, on a machine that may be busy
MOST_MEMORY = 3 << 30
SECONDS = float(os.environ.get("OLT_FUZZ_SECONDS", "60"))
"""How long the slow tests try each reader."""
EXAMPLES = int(os.environ.get("OLT_FUZZ_EXAMPLES", "25"))
"""How many mutations of each file the fast tests try."""

NUMBERS = [0, 1, 2, 7, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1]
TOKENS = [
    *(b"", b"0", b"-1", b"1e999", b"-1e999", b"1e-400", b"NaN", b"-Infinity", b".nan", b"null", b"~", b"true", b"NO"),
    *(
        b"9" * 30,
        b"9" * 5000,
        b"[]",
        b"{}",
        b"[[]]",
        b'""',
        b'"\\u0000"',
        b"\x00",
        b"\xff\xfe",
        b"\xc2\x85",
        b"\xed\xa0",
    ),
    *(b"[" * 3000, b'{"a":' * 3000, b'"' + b"x" * 5000 + b'"', b"../../etc", b"&a [*a]", b"!!python/name:os", b"010"),
    *(b"1:30", b"2024-01-01", b"<<: *a", b"\r\n", b",,,,", b'"', b"- - - -", b"? [a]"),
]


class Content(bytes):
    """Of a file; a report of a failure shows its size alone."""

    def __repr__(self):
        return f"{len(self)} bytes"


class Fuzzer:
    """The process that reads, started again whenever it was ended; `executions` counts what it read, by reader."""

    def __init__(self):
        self._process = None
        self.executions, self.seconds = {}, {}

    def problem(self, reader, path):
        """What is wrong with how a reader took a file; None if it read or refused it."""
        if self._process is None:
            self._process = subprocess.Popen([sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            self._answer(600.0)  # it is ready
        start = time.monotonic()
        self._process.stdin.write(json.dumps([reader, str(path)]).encode() + b"\n")
        self._process.stdin.flush()
        answer = self._answer(MOST_SECONDS)
        self.executions[reader] = self.executions.get(reader, 0) + 1
        self.seconds[reader] = self.seconds.get(reader, 0.0) + time.monotonic() - start
        if answer is None:
            self._process.kill()
            status = self._process.wait()
            self._process = None
            return f"took more than {MOST_SECONDS} s, or ended its process ({status})"
        return answer["problem"]

    def _answer(self, seconds):
        ready, _, _ = select.select([self._process.stdout], [], [], seconds)
        line = self._process.stdout.readline() if ready else b""
        return json.loads(line) if line else None

    def close(self):
        if self._process is not None:
            self._process.stdin.close()
            self._process.wait()

    def run(self, reader, path, opened=None, examples=EXAMPLES, seconds=None):
        """Mutate the file at `path` again and again, and have `opened` (the file itself, or its folder) read."""
        from hypothesis import HealthCheck, Phase, given, seed, settings

        path, opened = Path(path), Path(opened or path)
        valid = path.read_bytes()
        self.problem(reader, opened)  # imports what it needs, which may take longer than a file may
        first = self.problem(reader, opened)
        assert first is None, f"{reader}: {path.name}, which is whole: {first}"

        def attempt(content):
            path.write_bytes(content)
            problem = self.problem(reader, opened)
            if problem is not None:
                kept = Path(tempfile.gettempdir()) / f"fuzz-{reader.replace('/', '-')}-{path.name}"
                kept.write_bytes(content)
            assert problem is None, f"{reader}: {path.name}: {problem}; the content is kept in {kept}"

        end = None if seconds is None else time.monotonic() + seconds
        number = 0
        try:
            while number == 0 or (end is not None and time.monotonic() < end):
                tried = given(mutations(path.name, valid).map(Content))(attempt)
                tried = settings(
                    max_examples=examples if end is None else 40,
                    derandomize=end is None,
                    database=None,
                    deadline=None,
                    phases=[Phase.generate],
                    suppress_health_check=list(HealthCheck),
                    report_multiple_bugs=False,
                )(tried)
                (tried if end is None else seed(number)(tried))()
                number += 1
        finally:
            path.write_bytes(valid)


def mutations(name, valid):
    """Damaged contents of a file of this name, by what its content is."""
    from hypothesis import strategies as st

    choices = [damaged(valid)]
    if not valid:
        return choices[0]
    if name.endswith(".parquet"):
        choices += [retyped(valid), retyped(valid)]
    elif name.endswith(".gz"):
        inner = mutations(name.removesuffix(".gz"), gzip.decompress(valid))
        choices += [inner.map(gzip.compress)] * 3
    elif name.endswith((".zip", ".usdz")):
        choices += [repacked(valid), repacked(valid), repacked(valid)]
    elif name.endswith((".json", ".yaml", ".csv", ".txt", ".usda", ".xml", ".xodr", ".xosc")):
        choices += [reworded(valid), reworded(valid)]
    elif name.endswith(".mp4"):
        choices += [resized(valid)]
    return st.one_of(choices)


def damaged(valid):
    """Bits and bytes changed, cut, doubled, moved; numbers made extreme, in either order of bytes."""
    from hypothesis import strategies as st

    @st.composite
    def draw_damage(draw):
        data = bytearray(valid)
        for _ in range(draw(st.integers(1, 4))):
            size = len(data)
            if size == 0:
                break
            # Formats keep their tables at an end.
            near = draw(st.sampled_from([0, max(0, size - 512), 0, max(0, size - 8192)]))
            place = min(size - 1, near + draw(st.integers(0, size - near - 1)))
            length = draw(st.integers(1, max(1, min(64, size // 4))))
            kind = draw(st.sampled_from(["flip", "number", "cut", "drop", "double", "insert", "move", "fill"]))
            if kind == "flip":
                data[place] ^= 1 << draw(st.integers(0, 7))
            elif kind == "number":
                width, order = draw(st.sampled_from([1, 2, 4, 8])), draw(st.sampled_from(["little", "big"]))
                number = draw(st.sampled_from(NUMBERS)) % (1 << (8 * width))
                data[place : place + width] = number.to_bytes(width, order)
            elif kind == "cut":
                del data[place:]
            elif kind == "drop":
                del data[place : place + length]
            elif kind == "double":
                data[place:place] = data[place : place + length]
            elif kind == "insert":
                data[place:place] = draw(st.binary(max_size=16))
            elif kind == "move":
                part = data[place : place + length]
                del data[place : place + length]
                target = draw(st.integers(0, len(data)))
                data[target:target] = part
            else:
                data[place : place + length] = bytes([draw(st.integers(0, 255))]) * length
        return bytes(data)

    return draw_damage()


def reworded(valid):
    """Numbers and words of a text replaced by others, dropped, or doubled."""
    from hypothesis import strategies as st

    found = [match.span() for match in re.finditer(rb'"[^"]*"|-?[0-9.]+|[A-Za-z_]+|[\[\]{}:,\n]', valid)]

    @st.composite
    def draw_words(draw):
        data = valid
        for start, end in sorted(draw(st.sets(st.sampled_from(found), min_size=1, max_size=3)), reverse=True):
            token = draw(st.sampled_from([*TOKENS, data[start:end] * 2]))
            data = data[:start] + token + data[end:]
        return data

    return draw_words()


def retyped(valid):
    """Columns of a Parquet table of other types or extreme values, dropped, doubled or emptied."""
    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet as pq
    from hypothesis import strategies as st

    table = pq.read_table(io.BytesIO(valid))
    cells = [
        None,
        True,
        0,
        -1,
        2**63 - 1,
        -(2**63),
        1.5,
        -1.0,
        float("nan"),
        float("inf"),
        1e308,
        "",
        "x",
        "../x",
        "\x00",
    ]
    cells += ["y" * 5000, b"\xff", [], [1], [None], [-5, 5, 5], ["a", None], [[1]], {"a": 1}, [{"camera": "a"}], 2**40]
    arrays = [pa.array([cell]) for cell in cells]

    @st.composite
    def draw_table(draw):
        changed, count = table, draw(st.sampled_from([len(table), len(table), 0, 1, 3]))
        changed = changed.take(np.zeros(count, int)) if len(table) and count != len(table) else changed.slice(0, count)
        for _ in range(draw(st.integers(1, 2))):
            if changed.num_columns == 0:
                break
            place = draw(st.integers(0, changed.num_columns - 1))
            name, kind = changed.column_names[place], changed.schema.field(place).type
            how = draw(st.sampled_from(["replace", "replace", "same type", "same type", "drop", "double", "metadata"]))
            if how == "drop":
                changed = changed.remove_column(place)
            elif how == "double":
                changed = changed.append_column(name, changed.column(place))
            elif how == "metadata":
                keys = changed.schema.metadata or {b"a": b"b"}
                key = draw(st.sampled_from(sorted(keys)))
                changed = changed.replace_schema_metadata({**keys, key: draw(st.sampled_from(TOKENS))})
            else:
                cell = draw(st.sampled_from(arrays))
                if how == "same type":
                    try:
                        cell = cell.cast(kind)
                    except (pa.ArrowException, ValueError):
                        cell = pa.nulls(1, kind)
                values = cell.take(np.zeros(len(changed), int))
                keep = draw(st.booleans()) and values.type == kind and len(changed) > 1
                if keep:  # one row alone is wrong
                    values = pa.concat_arrays([changed.column(place).combine_chunks()[:-1], values[:1]])
                changed = changed.set_column(place, pa.field(name, values.type), values)
        sink = io.BytesIO()
        try:
            pq.write_table(changed, sink, compression=draw(st.sampled_from(["snappy", "zstd", "none"])))
        except (pa.ArrowException, ValueError, UnicodeDecodeError):
            return valid[: len(valid) // 2]
        return sink.getvalue()

    return draw_table()


def repacked(valid):
    """A zip of which one member is damaged within, renamed, doubled, dropped or packed otherwise."""
    from hypothesis import strategies as st

    with zipfile.ZipFile(io.BytesIO(valid)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    inner = {name: mutations(name, content) for name, content in members.items()}

    @st.composite
    def draw_zip(draw):
        chosen = draw(st.sampled_from(sorted(members)))
        how = draw(st.sampled_from(["damage", "damage", "damage", "rename", "double", "drop", "bomb"]))
        sink = io.BytesIO()
        packing = draw(st.sampled_from([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA]))
        with zipfile.ZipFile(sink, "w", packing) as archive:
            for name, content in members.items():
                if name == chosen and how == "drop":
                    continue
                if name == chosen and how == "rename":
                    name = draw(st.sampled_from(["../" + name, "/" + name, name.upper(), "x"]))
                if name == chosen and how == "damage":
                    content = draw(inner[name])
                if name == chosen and how == "bomb":
                    content = bytes(32 << 20)
                archive.writestr(name, content)
                if name == chosen and how == "double":
                    with warnings.catch_warnings(action="ignore"):
                        archive.writestr(zipfile.ZipInfo(name), content[: len(content) // 2])
        return sink.getvalue()

    return draw_zip()


def resized(valid):
    """An mp4 whose boxes claim other sizes, counts or names."""
    from hypothesis import strategies as st

    names = rb"moov|trak|mdia|minf|stbl|st[a-z]{2}|ctts|elst|avcC|mdhd|tkhd"
    boxes = [match.start() for match in re.finditer(names, valid)]

    @st.composite
    def draw_boxes(draw):
        data = bytearray(valid)
        for box in draw(st.sets(st.sampled_from(boxes), min_size=1, max_size=3)):
            offset = draw(st.sampled_from([-4, 4, 8, 12, 16, 20]))
            number = draw(st.sampled_from([each for each in NUMBERS if each < 2**32]))
            data[box + offset : box + offset + 4] = number.to_bytes(4, "big")
        return bytes(data)

    return draw_boxes()


# The process that reads.


def _read_store(path):
    from olt_toolkit.clips.store import ClipStore
    from olt_toolkit.policy.sample import SampleKey

    store = ClipStore(path)
    for info in store.clips():
        store.chunks()
        store.check(info.clip_id, info.sample_t0_us)
        store.read_vehicle(info.clip_id)
        for camera in info.views:
            store.read_camera(info.clip_id, camera)
        if info.sample_t0_us:
            store.load_samples([SampleKey(str(path), info.clip_id, info.sample_t0_us[0])], with_origin=True)


def _read_archive(path):
    from olt_toolkit.clips.chunk_archive import ChunkArchive

    archive = ChunkArchive(path)
    with zipfile.ZipFile(path) as known:  # it can be listed, or the line above refused it
        names = known.namelist()
    for name in names:
        archive.read(name)
        archive.locate(name)


def _read_clip_video(path):
    import numpy as np

    from olt_toolkit.clips.video import check_video, decode_frames, decode_images

    content = path.read_bytes()
    check_video(content, 4, "video")
    decode_frames(content, np.arange(4), "video")
    decode_images(content, np.arange(4), "video", (8, 8))


def _read_mp4_index(path):
    from olt_toolkit.clips.mp4_index import read_mp4_index

    content = path.read_bytes()
    read_mp4_index(lambda start, size: content[start : start + size], len(content))


def _read_video(path):
    from olt_generator.video import read_frame_times, read_video, read_video_window

    for read in (
        read_frame_times,
        lambda path: read_video(path, 64, 1.0),
        lambda path: read_video_window(path, 0, 200_000),
    ):
        _allow_refusal(read, path)


def _read_masks(path):
    import numpy as np

    from olt_toolkit.clips.origin_files import decode_origin

    runs = decode_origin(path.read_bytes(), "masks")
    runs.masks(np.arange(len(runs.timestamps_us)))
    runs.shares, runs.seen_frames  # noqa: B018


def _read_bytes(name):
    """Calls a reader of `clips.truth_tables` with the content of the file."""

    def read(path):
        from olt_toolkit.clips import truth_tables

        getattr(truth_tables, name)(path.read_bytes(), name)

    return read


def _scan_tables(path):
    from olt_datasets.tables.clip_frame import scan_clip_tables

    scan_clip_tables([path]).collect()


def _read_mixture(path):
    from olt_datasets.mixtures.mixture_file import read_mixture

    mixture = read_mixture(path)
    mixture.epoch(0, 4)
    mixture.describe()


def _check_recipe(path):
    """Read a recipe, and compose it of a table that lies beside it."""
    from olt_datasets.mixtures.mixture import check_recipe, compose_mixture
    from olt_datasets.mixtures.recipe import read_recipe
    from olt_datasets.tables.clip_frame import scan_clip_tables

    recipe, table = read_recipe(path), scan_clip_tables([path.parent / "clips.parquet"])
    check_recipe(recipe, table)
    compose_mixture(recipe, table, 0, (), True)


def _read_dataset(path):
    """Open every drive of a data set; the cache that this leaves holds whole files alone."""
    from olt_toolkit.recordings.drives import open_dataset
    from olt_toolkit.recordings.recording import OpenOptions

    with tempfile.TemporaryDirectory() as cache:
        try:
            dataset = open_dataset(path, Path(cache))
            for key in dataset.keys()[:2]:
                _allow_refusal(dataset.drive, key)
                _allow_refusal(lambda key: dataset.open(key, (0, 300_000), OpenOptions(width=64)), key)
        finally:
            hidden = [file.name for file in Path(cache).rglob("*") if file.name.startswith(".")]
            if hidden:
                raise AssertionError(f"left half-written files {hidden}")


def _allow_refusal(read, given):
    from olt_generator.errors import InputError

    try:
        read(given)
    except InputError as error:
        _check_message(error)


def _check_message(error):
    message = str(error)
    if "\n" in message or len(message) > 2000:
        raise AssertionError(f"the message is not one line of a size to be read: {message[:3000]!r}")


def _function(name):
    module, _, function = name.partition(":")
    return lambda path: getattr(__import__(module, fromlist=[function]), function)(path)


def _spin(path):
    end = time.process_time() + MOST_CPU_SECONDS + 0.5
    while time.process_time() < end:
        pass


def _read_scene(path):
    """Read a scene, and its looks, which may be damaged where the scene is not."""
    from olt_closed_loop.scenes.scene_file import read_looks, read_scene

    for read in (read_scene, read_looks):
        _allow_refusal(read, path)


READERS = {
    "archive": _read_archive,
    "checkpoint": _function("olt_sft_recipes.toy.checkpoint:read_model"),
    "clip table": _function("olt_toolkit.clips.table:read_clip_table"),
    "clip tables": _scan_tables,
    "clip video": _read_clip_video,
    "dataset": _read_dataset,
    "features": _function("olt_toolkit.clips.feature_table:read_feature_table"),
    "labels": _function("olt_datasets.tables.labels:read_labels"),
    "masks": _read_masks,
    "holds": _read_bytes("read_holds"),
    "mixture": _read_mixture,
    "mp4 index": _read_mp4_index,
    "obstacles": _read_bytes("read_obstacles"),
    "recipe": _check_recipe,
    "rig": _function("olt_toolkit.rigs.rig_files:read_rig"),
    "road": _read_bytes("read_road"),
    "rollout": _function("olt_closed_loop.rollouts.rollout_files:read_rollout_file"),
    "rollouts": _function("olt_closed_loop.rollouts.rollout_tables:load_rollouts"),
    "route": _read_bytes("read_route"),
    "scenario": _function("olt_closed_loop.scenes.sources:read_recording"),
    "scene": _read_scene,
    "stage config": _function("olt_sft_recipes.training.stage_config:read_stage_config"),
    "store": _read_store,
    "suite": _function("olt_closed_loop.suite.files:read_suite"),
    "fault: raise": lambda path: 1 / 0,
    "fault: raise if damaged": lambda path: None if path.read_text() == "one two" else 1 / 0,
    "fault: abort": lambda path: os.abort(),
    "fault: spin": _spin,
    "fault: swell": lambda path: bytes(2 * MOST_MEMORY),
    "video": _read_video,
}


def main():
    import traceback

    import olt_toolkit.clips.store  # noqa: F401
    from olt_generator.errors import InputError

    used = int(re.search(r"VmData:\s+(\d+)", Path("/proc/self/status").read_text())[1]) << 10
    resource.setrlimit(resource.RLIMIT_DATA, (used + MOST_MEMORY, used + MOST_MEMORY))
    # Decoders complain to standard output and error; only answers go to where the first was.
    answers = os.fdopen(os.dup(1), "w")
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    print("{}", file=answers, flush=True)
    for line in sys.stdin:
        reader, path = json.loads(line)
        problem, start = None, time.process_time()
        try:
            READERS[reader](Path(path))
        except InputError as error:
            try:
                _check_message(error)
            except AssertionError as wrong:
                problem = str(wrong)
        except BaseException as error:  # polars' panics are not exceptions
            problem = "".join(traceback.format_exception(error))[-3000:]
        if (spent := time.process_time() - start) > MOST_CPU_SECONDS:
            problem = f"took {spent:.1f} s of a processor; {problem}"
        print(json.dumps({"problem": problem}), file=answers, flush=True)


if __name__ == "__main__":
    main()
