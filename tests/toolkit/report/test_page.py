import json
import re

from olt_toolkit.report.blocks import Bullets, DrivenPath, Picture, Rollouts, Section, Table, Text
from olt_toolkit.report.page import write_report


def make_rollouts():
    ego = DrivenPath("policy <a>", "#1f6feb", 4.5, 1.9, 1.4, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.1]], {1: "collision"})
    agent = DrivenPath("automobile", "#555", 4.0, 1.8, 0.0, [None, [9.0, 0.0, 3.14]])
    area = [[0, -4], [50, -4], [50, 4], [0, 4]]
    return Rollouts("Scene", "caption", 0.1, [area], [[[0, 0], [50, 0]]], [[0, 0], [50, 0]], [ego], [agent])


def test_page_needs_no_other_file_and_escapes_text(tmp_path):
    path = tmp_path / "report.html"
    (tmp_path / "picture.png").write_bytes(b"\x89PNG")
    picture = Picture.from_file(tmp_path / "picture.png", "a picture")
    blocks = [Text("5 < 6 & so on"), Bullets(["one"]), Table(["a"], [[None], [1.23456]]), picture, make_rollouts()]
    write_report(path, "Title", "Summary", [Section("Results", blocks)])
    page = path.read_text()
    assert "5 &lt; 6 &amp; so on" in page
    assert "not measured" in page and "1.235" in page
    assert not re.search(r'(src|href)="(?!data:|#)', page)
    assert "http" not in page.replace("http://www.w3.org", "")


def test_rollouts_reach_the_script_as_json(tmp_path):
    path = tmp_path / "report.html"
    write_report(path, "Title", "Summary", [Section("Rollouts", [make_rollouts()])])
    text = re.search(r'<script type="application/json">(.*?)</script>', path.read_text(), re.S).group(1)
    data = json.loads(text)
    assert data["paths"][0]["poses"][1] == [1.0, 0.0, 0.1]
    assert data["paths"][0]["events"] == {"1": "collision"}
    assert data["agents"][0]["poses"][0] is None
