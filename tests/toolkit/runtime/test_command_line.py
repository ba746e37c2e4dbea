import json
import os
import signal
import subprocess
import sys
import time

import pytest
import typer

from olt_generator.errors import InputError
from olt_toolkit.runtime import command_line as cli


@pytest.fixture
def one_command(monkeypatch):
    """Replace the registered commands by one; returns a function that sets what the command does."""
    app = typer.Typer(add_completion=False)
    work = {}

    @app.command()
    def example(as_json: bool = typer.Option(False, "--json")) -> None:
        work["do"]()

    class Entry:
        name = "example"

        def load(self):
            return app

    monkeypatch.setattr(cli, "entry_points", lambda group: [Entry()])
    return lambda function: work.update(do=function)


def test_input_error_is_one_line_and_status_1(one_command, capsys):
    def fail():
        raise InputError("video.mp4: not a video; give an mp4 file")

    one_command(fail)
    assert cli.run(["example"]) == 1
    assert capsys.readouterr().err == "olt: video.mp4: not a video; give an mp4 file\n"


def test_full_disk_is_one_line(one_command, capsys):
    def fail():
        raise OSError(28, "No space left on device", "out/clip.zip")

    one_command(fail)
    assert cli.run(["example"]) == 1
    assert capsys.readouterr().err.startswith("olt: out/clip.zip: No space left on device; ")


def test_a_programming_error_keeps_its_traceback(one_command):
    one_command(lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        cli.run(["example"])


def test_wrong_option_is_status_2(one_command, capsys):
    one_command(lambda: None)
    assert cli.run(["example", "--nonsense"]) == 2
    assert "--nonsense" in capsys.readouterr().err


def test_status_of_a_command_is_kept(one_command):
    def stop():
        raise typer.Exit(3)

    one_command(stop)
    assert cli.run(["example"]) == 3


def run_olt(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "olt_toolkit", *arguments], capture_output=True, text=True, timeout=120
    )


def test_every_registered_command_answers_help():
    listing = run_olt("--help")
    assert listing.returncode == 0
    for name in ("bench", "clip", "closed-loop", "demo", "doctor", "mix", "sft"):
        assert name in listing.stdout
        assert run_olt(name, "--help").returncode == 0


def test_help_loads_no_heavy_library():
    code = (
        "import sys; from olt_toolkit.runtime.command_line import build_command; build_command();"
        "heavy = ('torch', 'numpy', 'cv2', 'casadi', 'pxr', 'pandas', 'matplotlib');"
        "print([name for name in heavy if name in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert result.stdout.strip() == "[]", result.stderr


def test_doctor_names_versions_and_parts():
    result = run_olt("doctor", "--json")
    report = json.loads(result.stdout)
    assert result.returncode == 0
    assert report["ready"] and report["machine"]["packages"]["torch"]
    assert {part["name"] for part in report["optional_parts"]} == {"learned", "devkit", "distributed"}


@pytest.mark.skipif(os.name != "posix", reason="signals are a matter of POSIX")
def test_ctrl_c_is_one_line_and_status_130(tmp_path):
    code = (
        "import time; from olt_toolkit.runtime import command_line;"
        "command_line.run = lambda _: (print('started', flush=True), time.sleep(60)); command_line.main([])"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "started\n"
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=30)
    assert process.returncode == 130
    assert error == "olt: interrupted; run the same command again to go on\n"
