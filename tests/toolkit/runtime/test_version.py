import olt_toolkit
from olt_toolkit.runtime.version import code_version, hash_source


def test_the_version_is_told():
    assert code_version().split("+")[0] == olt_toolkit.__version__


def test_edited_source_is_told_apart(tmp_path):
    names = ("toolkit/generator/olt_generator/a.py", "toolkit/olt_toolkit/rigs/pav.yaml", "datasets/olt_datasets/b.py")
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_text(name)
    hashes = {hash_source(tmp_path)}
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests/test_a.py").write_text("not of the packages")
    assert hashes == {hash_source(tmp_path)}
    for name in names:
        (tmp_path / name).write_text("edited")
        hashes.add(hash_source(tmp_path))
    (tmp_path / names[0]).rename(tmp_path / "toolkit/generator/olt_generator/c.py")
    hashes.add(hash_source(tmp_path))
    assert len(hashes) == 5
