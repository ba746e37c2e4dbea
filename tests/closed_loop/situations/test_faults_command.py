"""`olt closed-loop faults`, and the reason in the table of a rollout."""

import json

import numpy as np
from typer.testing import CliRunner

from olt_closed_loop import commands
from olt_closed_loop.situations import table


def test_the_command_prints_one_object_and_fails_where_a_verdict_is_wrong(monkeypatch):
    monkeypatch.setattr(table, "SITUATIONS", table.SITUATIONS[:3])
    result = CliRunner().invoke(commands.app, ["faults", "--json"])
    values = json.loads(result.stdout)
    assert (result.exit_code, values["right"], len(values["situations"])) == (0, 3, 3)
    assert values["situations"][0]["rule"] == "standing"
    wrong = table.Situation(**{**vars(table.SITUATIONS[0]), "at_fault": True})
    monkeypatch.setattr(table, "SITUATIONS", (wrong,))
    result = CliRunner().invoke(commands.app, ["faults"])
    assert result.exit_code == 1
    assert "WRONG" in result.stdout and "0 of 1 situations right" in result.stdout


def test_pictures_are_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(table, "SITUATIONS", table.SITUATIONS[:2])
    path = tmp_path / "situations.png"
    result = CliRunner().invoke(commands.app, ["faults", "--picture", str(path)])
    assert result.exit_code == 0
    assert path.read_bytes().startswith(b"\x89PNG")
    result = CliRunner().invoke(commands.app, ["faults", "--sweeps", str(tmp_path / "sweeps.txt")])
    assert result.exit_code == 2
    assert not (tmp_path / "sweeps.txt").exists()


def test_a_rollout_tells_whose_fault_its_contacts_were(tmp_path, texts):
    values = texts.rollout(texts.along_x(), agents={"parked": texts.agent(np.tile([60.0, 0.0, 0.0], (81, 1)))})
    path = tmp_path / "drive.json"
    path.write_text(json.dumps(values))
    result = CliRunner().invoke(commands.app, ["score-rollout", str(path)])
    assert "at fault: avoidable (the agent stood there" in " ".join(result.stdout.split())
    result = CliRunner().invoke(commands.app, ["score-rollout", str(path), "--json"])
    (hit,) = json.loads(result.stdout)["collisions"]
    assert (hit["at_fault"], hit["rule"]) == (True, "avoidable") and "in time to brake" in hit["reason"]


def test_a_contact_at_the_first_sample_is_named_among_what_was_left_out(tmp_path, texts):
    values = texts.rollout(texts.along_x(), agents={"late": texts.agent(texts.along_x()[40:], start=40)})
    path = tmp_path / "drive.json"
    path.write_text(json.dumps(values))
    result = json.loads(CliRunner().invoke(commands.app, ["score-rollout", str(path), "--json"]).stdout)
    assert (result["collisions"], result["collided"], result["score"]) == ([], False, 1.0)
    assert ("contact with late", "appeared in contact") in {(left["what"], left["why"]) for left in result["left_out"]}
    result = CliRunner().invoke(commands.app, ["score-rollout", str(path)])
    assert "left out: contact with late" in " ".join(result.stdout.split())
