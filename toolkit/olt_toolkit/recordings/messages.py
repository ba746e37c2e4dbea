"""Classes of Protocol Buffers messages, made of the fields that are read; nothing is generated or compiled."""

from collections.abc import Mapping, Sequence

from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import Message
from google.protobuf.message_factory import GetMessageClass

Fields = Sequence[tuple[int, str, str]]
"""Number, name and type of each field of a message: a type with a star is repeated, one that is no scalar is another
message. Fields that are not named are kept by the parser as unknown ones and never looked at."""


def make_message_class(package: str, messages: Mapping[str, Fields], name: str) -> type[Message]:
    """The class of the message `name` among those of a package (`proto2`)."""
    file = FileDescriptorProto(name=f"{package}.proto", package=package, syntax="proto2")
    for message_name, fields in messages.items():
        message = file.message_type.add(name=message_name)
        for number, field, kind in fields:
            scalar = kind.rstrip("*")
            label = FieldDescriptorProto.LABEL_REPEATED if kind.endswith("*") else FieldDescriptorProto.LABEL_OPTIONAL
            added = message.field.add(name=field, number=number, label=label)
            if scalar in messages:
                added.type, added.type_name = FieldDescriptorProto.TYPE_MESSAGE, f".{package}.{scalar}"
            else:
                added.type = FieldDescriptorProto.Type.Value(f"TYPE_{scalar.upper()}")
    pool = DescriptorPool()
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(f"{package}.{name}"))
