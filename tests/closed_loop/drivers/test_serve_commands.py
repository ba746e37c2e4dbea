"""`olt closed-loop serve` and `serve-vehicle` as processes, and `--policy grpc://` from the command line."""

import json
import re
import signal
import subprocess
import sys
from contextlib import contextmanager

import grpc
import pytest

from olt_closed_loop.drivers import contract


@contextmanager
def served(*arguments):
    """The address at which a process of the command line serves; it is told to end afterwards, and does."""
    command = [sys.executable, "-m", "olt_toolkit", "closed-loop", *arguments, "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            line = process.stdout.readline()
            found = re.search(r"at (127\.0\.0\.1:\d+)$", line.strip())
            assert found, line + process.stderr.read()
            yield found[1], line
            process.send_signal(signal.SIGTERM)
            assert process.wait(30) == 0, process.stderr.read()
        finally:
            process.kill()


def run_command(*arguments):
    command = [sys.executable, "-m", "olt_toolkit", "closed-loop", "run", *arguments, "--json"]
    return subprocess.run(command, capture_output=True, text=True, timeout=300)


def drive_over_loopback(*options):
    with served("serve", "--policy", "route") as (address, line):
        assert "route serves egodriver.EgodriverService" in line
        drive = ("--policy", f"grpc://{address}", "--rollouts", "1", "--duration", "3", "--no-baselines")
        done = run_command("cyclists:1", "nominal:2", *drive, *options)
        assert done.returncode == 0, done.stderr
        stub = contract.Stub(grpc.insecure_channel(address), contract.EGODRIVER)
        assert stub.get_version(contract.Empty()).version_id.startswith("route-openlongtail-")
    scores = json.loads(done.stdout)["scores"]
    assert [score["score"] is not None for score in scores] == [True, True]


def test_a_served_policy_drives_from_the_command_line():
    drive_over_loopback("--workers", "1")


@pytest.mark.slow
@pytest.mark.parametrize("isolate", ["none", "process"])
def test_a_served_policy_drives_in_several_processes(isolate):
    drive_over_loopback("--workers", "2", "--isolate", isolate)


def test_a_served_vehicle_answers():
    with served("serve-vehicle", "--vehicle", "kinematic") as (address, line):
        assert "kinematic-linear serves controller.VDCService" in line
        stub = contract.Stub(grpc.insecure_channel(address), contract.VEHICLE)
        assert stub.get_version(contract.Empty()).version_id.startswith("kinematic-linear-openlongtail-")
        stub.start_session(contract.VDCSessionRequest(session_uuid="a"))


def test_what_cannot_be_served_is_said_in_words():
    command = [sys.executable, "-m", "olt_toolkit", "closed-loop", "serve", "--policy", "nobody"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode != 0
    assert "policy 'nobody' is not known" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_nobody_at_the_address_is_said_in_words():
    options = ("--rollouts", "1", "--duration", "3", "--no-baselines")
    done = run_command("cyclists:1", "--policy", "grpc://127.0.0.1:1", *options)
    assert done.returncode == 1
    assert "could not be reached at 127.0.0.1:1" in done.stdout + done.stderr
