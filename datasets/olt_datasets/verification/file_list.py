"""The checksums of all files of an export whose layout has no place for them: `checksums.parquet`, by path."""

from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from olt_generator.errors import InputError
from olt_generator.files import write_whole
from olt_toolkit.clips.checksums import checksum_bytes
from olt_toolkit.clips.pai_tables import read_table
from olt_toolkit.clips.verification.findings import Finding, Verdict, judge, not_compared, state

FILE_LIST = "checksums.parquet"
_SUMMARY = "export.json"


def write_file_list(root: Path) -> None:
    """Write the list of all files below a folder, but for hidden ones, the list and the summary."""
    files = list_files(root)
    with write_whole(root / FILE_LIST) as temporary:
        checksums = [checksum_bytes((root / file).read_bytes()) for file in files]
        pq.write_table(pa.table({"file": files, "checksum": checksums}), temporary)


def list_files(root: Path) -> list[str]:
    """Paths of files below a folder, in their order; hidden ones, the list and the summary are not among them."""
    paths = (path.relative_to(root) for path in root.rglob("*") if path.is_file() and not path.is_symlink())
    shown = (path for path in paths if not any(part.startswith(".") for part in path.parts))
    return sorted(path.as_posix() for path in shown if path.as_posix() not in (FILE_LIST, _SUMMARY))


def check_file_list(root: Path) -> Iterator[Finding]:
    """Compare the checksum of every file with that of the list; one that is another's is told as such."""
    where = str(root / FILE_LIST)
    if not (root / FILE_LIST).is_file():
        yield not_compared("checksums", where, "the folder has no list of checksums")
        return
    try:
        table = read_table(root / FILE_LIST, ["file", "checksum"], where)
    except InputError as error:
        yield state("checksums", where, False, str(error))
        return
    known = dict(zip(table["file"].to_pylist(), table["checksum"].to_pylist(), strict=True))
    owners = {checksum: file for file, checksum in known.items()}
    found = list_files(root)
    for file in found:
        if file in known:
            yield _compare(root, file, known[file], owners)
    lost, strange = sorted(known.keys() - set(found)), sorted(set(found) - known.keys())
    detail = "files of the list are missing" + "".join(f", as {file}" for file in lost[:1])
    yield judge("all files", where, float(len(lost)), 0.0, detail)
    detail = "files are not in the list" + "".join(f", as {file}" for file in strange[:1])
    yield judge("no other files", where, float(len(strange)), 0.0, detail)


def _compare(root: Path, file: str, known: str, owners: dict[str, str]) -> Finding:
    checksum = checksum_bytes((root / file).read_bytes())
    if checksum == known:
        return Finding("checksums", str(root / file), Verdict.PASSED, "as it was written")
    other = owners.get(checksum)
    why = f"this is the file {other}; files were swapped" if other else "the file was changed after it was written"
    return Finding("checksums", str(root / file), Verdict.FAILED, f"{why}; export again")
