"""Compile the proto files of AlpaSim's services to the descriptors that the package loads."""

import sys
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "closed_loop/olt_closed_loop/drivers/proto"
SERVICES = ("alpasim_grpc/v0/egodriver.proto", "alpasim_grpc/v0/controller.proto")


def compile_protos(out: Path) -> None:
    """Write the descriptors of both services and of all that they need."""
    from grpc_tools import protoc

    status = protoc.main(["protoc", f"-I{FOLDER}", "--include_imports", f"--descriptor_set_out={out}", *SERVICES])
    if status:
        sys.exit(status)


if __name__ == "__main__":
    compile_protos(FOLDER / "alpasim.binpb")
