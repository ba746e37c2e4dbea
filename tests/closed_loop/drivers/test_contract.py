"""The contract that our proto files write down: compiled again it is the same, and it is what a peer speaks."""

import importlib
import sys

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from olt_closed_loop.drivers import contract

from .peers import ROOT

PEER_FILES = ("common", "sensorsim", "egodriver")


def test_the_descriptors_are_those_of_the_proto_files(tmp_path):
    pytest.importorskip("grpc_tools", reason="needs grpcio-tools, which compiles proto files")
    sys.path.insert(0, str(ROOT / "tools"))
    try:
        tool = importlib.import_module("compile_protos")
    finally:
        sys.path.pop(0)
    tool.compile_protos(tmp_path / "again.binpb")
    again, kept = (
        FileDescriptorSet.FromString(path.read_bytes())
        for path in (tmp_path / "again.binpb", tool.FOLDER / "alpasim.binpb")
    )
    assert again == kept


def fields_of(message):
    found = {}
    for field in message.fields:
        other = field.message_type or field.enum_type
        found[field.name] = field.number, field.type, field.is_repeated, other.full_name if other else None
    return found


def messages_of(file):
    for message in file.message_types_by_name.values():
        yield from nested_messages(message)


def nested_messages(message):
    yield message
    for nested in message.nested_types:
        yield from nested_messages(nested)


@pytest.mark.parametrize("name", PEER_FILES)
def test_messages_are_those_of_the_peer(name):
    pytest.importorskip("carla_driver_interface", reason="needs the package carla-driver-interface")
    theirs = importlib.import_module(f"carla_driver_interface._proto.{name}_pb2").DESCRIPTOR
    ours = contract._POOL.FindFileByName(f"alpasim_grpc/v0/{name}.proto")
    peer = {message.full_name: fields_of(message) for message in messages_of(theirs)}
    for message in messages_of(ours):
        for field, entry in fields_of(message).items():
            assert peer[message.full_name][field] == entry, (message.full_name, field)
    for service in ours.services_by_name.values():
        methods = theirs.services_by_name[service.name].methods
        assert {(m.name, m.input_type.full_name, m.output_type.full_name) for m in methods} == {
            (m.name, m.input_type.full_name, m.output_type.full_name) for m in service.methods
        }


def test_numbers_of_the_vehicle_service():
    request = contract.RunRequest(session_uuid="s", future_time_us=2, coerce_dynamic_state=True)
    request.state.timestamp_us, request.pose_reporting_interval_us = 1, 3
    request.planned_trajectory_in_rig.poses.add()
    numbers = {field.number: field.name for field, _ in request.ListFields()}
    assert numbers == {
        1: "session_uuid",
        2: "state",
        3: "planned_trajectory_in_rig",
        4: "future_time_us",
        5: "coerce_dynamic_state",
        6: "pose_reporting_interval_us",
    }
    states = contract.RunResponse.DESCRIPTOR.fields_by_name["states"]
    assert states.number == 6
    assert [(field.number, field.name) for field in states.message_type.fields] == [
        (1, "timestamp_us"),
        (2, "pose_local_to_rig"),
        (3, "pose_local_to_rig_estimated"),
        (4, "dynamic_state"),
        (5, "dynamic_state_estimated"),
    ]
    assert contract.VEHICLE.full_name == "controller.VDCService"
    assert {method.name for method in contract.VEHICLE.methods} == {
        "get_version",
        "start_session",
        "close_session",
        "run_controller_and_vehicle",
    }
