"""A folder in which the blocks of a page are carried out one after the other."""

import sys
import tomllib
from pathlib import Path

import pytest

from olt_toolkit.runtime import command_line

from .documented import Fence, split_commands


class Page:
    """Carries out the blocks of one page in a folder of its own."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self._folder = folder
        self._monkeypatch = monkeypatch
        self._names: dict[str, object] = {"__name__": "__main__"}
        monkeypatch.chdir(folder)
        # What readers keep for later goes into the folder; the fonts that plots have found stay where they are.
        monkeypatch.setenv("MPLCONFIGDIR", str(Path.home() / ".cache" / "matplotlib"))
        monkeypatch.setenv("HOME", str(folder / "home"))

    def carry_out(self, fence: Fence) -> None:
        """Write the file, run the commands, or execute the Python of a block."""
        if fence.title is not None:
            path = self._folder / fence.title
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(fence.body, encoding="utf-8")
        elif fence.language == "python":
            exec(compile(fence.body, "documented", "exec"), self._names)
        elif fence.language == "sh":
            for words in split_commands(fence.body):
                self._run(words)

    def _run(self, words: list[str]) -> None:
        if words[0] == "olt":
            status = command_line.run(words[1:])
            assert status == 0, f"{' '.join(words)}: status {status}"
        elif words[:3] == ["pip", "install", "--editable"]:
            self._install(self._folder / words[3])
        else:
            pytest.fail(f"{' '.join(words)}: mark the block as `<!-- not run: REASON -->`")

    def _install(self, project: Path) -> None:
        """What an editable installation does: put the project on the path and make its entry points known."""
        about = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        lines = [
            f"[{group}]\n" + "\n".join(f"{k} = {v}" for k, v in items.items())
            for group, items in about["entry-points"].items()
        ]
        metadata = project / f"{about['name']}-{about['version']}.dist-info"
        metadata.mkdir()
        (metadata / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {about['name']}\nVersion: {about['version']}\n"
        )
        (metadata / "entry_points.txt").write_text("\n".join(lines))
        self._monkeypatch.syspath_prepend(project)


@pytest.fixture
def page_folder(tmp_path, monkeypatch):
    """Carries out blocks in an empty folder; modules that they brought are forgotten afterwards."""
    before = set(sys.modules)
    yield Page(tmp_path, monkeypatch)
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", "") or "").startswith(str(tmp_path)):
            del sys.modules[name]
