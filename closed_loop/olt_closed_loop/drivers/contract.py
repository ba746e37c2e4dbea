"""Messages and services of AlpaSim's contract, from our own proto files (`proto/`).

`tools/compile_protos.py` compiles them to descriptors, of which messages are made here by whatever protobuf is
installed. They stand in a pool of their own: a process that also loads AlpaSim's package, or another one that speaks
the contract, has no clash of names.

Services are met by `Stub` on one side and `serve_methods` on the other; both take the names of the proto files.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import grpc
from google.protobuf.descriptor import ServiceDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from olt_generator.errors import InputError

API_VERSION = (0, 54, 0)
"""Of AlpaSim's contract (its package alpasim_grpc at 3032e0c)."""
LARGEST_MESSAGE = 64 * 2**20
"""Bytes. A frame of 1080 x 1920 has less than 4 MiB as PNG; gRPC's own limit of 4 MiB leaves it no room."""
CHANNEL_OPTIONS = [
    ("grpc.max_send_message_length", LARGEST_MESSAGE),
    ("grpc.max_receive_message_length", LARGEST_MESSAGE),
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 1000),
]


def _load_pool() -> DescriptorPool:
    pool = DescriptorPool()
    descriptors = (Path(__file__).parent / "proto" / "alpasim.binpb").read_bytes()
    for file in FileDescriptorSet.FromString(descriptors).file:
        pool.AddSerializedFile(file.SerializeToString())
    return pool


_POOL = _load_pool()


def _message(name: str) -> Any:
    return GetMessageClass(_POOL.FindMessageTypeByName(name))


Empty: Any = _message("common.Empty")
Vec3: Any = _message("common.Vec3")
Pose: Any = _message("common.Pose")
Trajectory: Any = _message("common.Trajectory")
DynamicState: Any = _message("common.DynamicState")
VersionId: Any = _message("common.VersionId")
SessionRequestStatus: Any = _message("common.SessionRequestStatus")
AvailableCamera: Any = _message("nre.grpc.protos.sensorsim.AvailableCamerasReturn.AvailableCamera")
DriveSessionRequest: Any = _message("egodriver.DriveSessionRequest")
DriveSessionCloseRequest: Any = _message("egodriver.DriveSessionCloseRequest")
RolloutCameraImage: Any = _message("egodriver.RolloutCameraImage")
RolloutEgoTrajectory: Any = _message("egodriver.RolloutEgoTrajectory")
RouteRequest: Any = _message("egodriver.RouteRequest")
DriveRequest: Any = _message("egodriver.DriveRequest")
DriveResponse: Any = _message("egodriver.DriveResponse")
VDCSessionRequest: Any = _message("controller.VDCSessionRequest")
VDCSessionCloseRequest: Any = _message("controller.VDCSessionCloseRequest")
RunRequest: Any = _message("controller.RunControllerAndVehicleModelRequest")
RunResponse: Any = _message("controller.RunControllerAndVehicleModelResponse")

EGODRIVER: ServiceDescriptor = _POOL.FindServiceByName("egodriver.EgodriverService")
VEHICLE: ServiceDescriptor = _POOL.FindServiceByName("controller.VDCService")
SHUTTER_GLOBAL: int = _POOL.FindEnumTypeByName("nre.grpc.protos.sensorsim.ShutterType").values_by_name["GLOBAL"].number


class Stub:
    """The methods of a service at the other end of a channel, by the names of its proto file."""

    def __init__(self, channel: grpc.Channel, service: ServiceDescriptor) -> None:
        self._methods = {
            method.name: channel.unary_unary(
                f"/{service.full_name}/{method.name}",
                request_serializer=GetMessageClass(method.input_type).SerializeToString,
                response_deserializer=GetMessageClass(method.output_type).FromString,
            )
            for method in service.methods
        }

    def __getattr__(self, name: str) -> Any:
        return self._methods[name]


class CallRefused(Exception):
    """A call that a service does not answer: the gRPC status, and why."""

    def __init__(self, code: grpc.StatusCode, reason: str) -> None:
        super().__init__(reason)
        self.code = code


class Servicer(Protocol):
    """What a service is made of: a method (request, context) -> response for each of its proto file."""

    service: ServiceDescriptor


def serve_methods(servicer: Servicer) -> grpc.GenericRpcHandler:
    """The handlers of all methods of a service. An `InputError` of a method is a request that makes no sense."""
    methods = {
        method.name: grpc.unary_unary_rpc_method_handler(
            _answer(getattr(servicer, method.name)),
            request_deserializer=GetMessageClass(method.input_type).FromString,
            response_serializer=GetMessageClass(method.output_type).SerializeToString,
        )
        for method in servicer.service.methods
    }
    return grpc.method_handlers_generic_handler(servicer.service.full_name, methods)


def _answer(method: Callable[[Any, grpc.ServicerContext], Any]) -> Callable[[Any, grpc.ServicerContext], Any]:
    def answer(request: Any, context: grpc.ServicerContext) -> Any:
        try:
            return method(request, context)
        except CallRefused as refusal:
            context.abort(refusal.code, str(refusal))
        except InputError as error:
            context.abort(grpc.StatusCode.INVALID_ARGUMENT, str(error))

    return answer


def version_of(what: str) -> Any:
    """The `VersionId` of a service of ours."""
    from olt_generator.version import __version__

    major, minor, patch = API_VERSION
    version = VersionId(version_id=f"{what}-openlongtail-{__version__}", git_hash="")
    version.grpc_api_version.major, version.grpc_api_version.minor, version.grpc_api_version.patch = major, minor, patch
    return version
