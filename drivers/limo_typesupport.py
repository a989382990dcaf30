"""Makes ``limo_msgs/msg/LimoStatus`` known to rclpy without a package that was built for it.

rclpy finds out about a message type through a C structure, ``rosidl_message_type_support_t``, that generated code hands
over. Subscribing to and publishing serialised messages uses little of it: the type's name, the size of its buffers,
its hash and, for the type object that Fast DDS registers, the list of its fields. So this file makes that structure at
run time with ctypes, from the one of ``std_msgs/msg/Header``, which is a LimoStatus' first field. Only raw
subscriptions and ``publish(bytes)`` may be used with it: nothing converts the other fields.

The layouts are those of ROS 2 Jazzy (message_type_support_struct.h of rosidl_runtime_c 4.6, message_type_support.h of
rosidl_typesupport_fastrtps_cpp 3.6, message_introspection.h of rosidl_typesupport_introspection_c 4.6), the release
whose wheels this project installs. What the robot runs does not matter: on the wire only the name
``limo_msgs::msg::dds_::LimoStatus_`` counts, which Humble and Jazzy share.
"""

from __future__ import annotations

import ctypes
from typing import Any

_GENERIC, _FAST_DDS = b"rosidl_typesupport_c", b"rosidl_typesupport_fastrtps_c"
_INTROSPECTION = b"rosidl_typesupport_introspection_c"
_HASH = "044e1af6d09bd2b2081ffdc5626648fe543a0364c4e69f2be69d3e44a455065d"
"""RIHS01 hash (REP-2016) of LimoStatus.msg; it tells tools such as rosbag2 which definition is meant."""
_UINT8, _UINT16, _DOUBLE, _MESSAGE = 8, 10, 2, 18

_Find = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)
_Hash = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)


class _Handle(ctypes.Structure):
    """The structure rosidl_message_type_support_t."""

    _fields_ = [
        ("identifier", ctypes.c_char_p),
        ("data", ctypes.c_void_p),
        ("find", _Find),
        ("hash", _Hash),
        ("description", ctypes.c_void_p),
        ("sources", ctypes.c_void_p),
    ]


class _Callbacks(ctypes.Structure):
    """The structure message_type_support_callbacks_t of Fast DDS."""

    _fields_ = [("namespace", ctypes.c_char_p), ("name", ctypes.c_char_p), ("functions", ctypes.c_void_p * 5)]


class _Member(ctypes.Structure):
    """One field: rosidl_typesupport_introspection_c__MessageMember."""

    _fields_ = [
        ("name", ctypes.c_char_p),
        ("type_id", ctypes.c_uint8),
        ("string_upper_bound", ctypes.c_size_t),
        ("members", ctypes.c_void_p),
        ("is_key", ctypes.c_bool),
        ("is_array", ctypes.c_bool),
        ("array_size", ctypes.c_size_t),
        ("is_upper_bound", ctypes.c_bool),
        ("offset", ctypes.c_uint32),
        ("functions", ctypes.c_void_p * 7),
    ]


class _Members(ctypes.Structure):
    """The fields: rosidl_typesupport_introspection_c__MessageMembers."""

    _fields_ = [
        ("namespace", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("count", ctypes.c_uint32),
        ("size", ctypes.c_size_t),
        ("has_key", ctypes.c_bool),
        ("members", ctypes.POINTER(_Member)),
        ("functions", ctypes.c_void_p * 2),
    ]


_forever: list[Any] = []
"""What C code points at: never released."""


def _copy(handle: _Handle, data: ctypes.Structure, hash_: Any) -> _Handle:
    copy = _Handle.from_buffer_copy(handle)
    copy.data, copy.hash = ctypes.addressof(data), hash_
    return copy


def status_type(header: Any) -> Any:
    """The class to give to ``create_subscription(..., raw=True)`` and ``create_publisher``.

    Args:
        header: ``std_msgs.msg.Header``.

    Raises:
        RuntimeError: when this installation of ROS is built otherwise than expected.
    """
    meta = header.__class__
    if meta._TYPE_SUPPORT is None:
        meta.__import_type_support__()
    api = ctypes.pythonapi
    api.PyCapsule_GetPointer.restype = ctypes.c_void_p
    api.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    api.PyCapsule_GetName.restype = ctypes.c_char_p
    api.PyCapsule_GetName.argtypes = [ctypes.py_object]
    api.PyCapsule_New.restype = ctypes.py_object
    api.PyCapsule_New.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    name = api.PyCapsule_GetName(meta._TYPE_SUPPORT)
    donor = _Handle.from_address(api.PyCapsule_GetPointer(meta._TYPE_SUPPORT, name))
    found = [donor.find(ctypes.addressof(donor), key) for key in (_FAST_DDS, _INTROSPECTION)]
    if donor.identifier != _GENERIC or None in found:
        raise RuntimeError("std_msgs has no type support for Fast DDS")
    fast, introspection = (_Handle.from_address(address) for address in found)
    callbacks = _Callbacks.from_buffer_copy(_Callbacks.from_address(fast.data))
    fields = _Members.from_address(introspection.data)
    if (callbacks.namespace, callbacks.name, fields.name, fields.count) != (b"std_msgs::msg", b"Header", b"Header", 2):
        raise RuntimeError("the type support of std_msgs is laid out in another way than that of ROS 2 Jazzy")

    digest = (ctypes.c_uint8 * 33)(1, *bytes.fromhex(_HASH))
    hash_ = _Hash(lambda _: ctypes.addressof(digest))
    callbacks.namespace, callbacks.name = b"limo_msgs::msg", b"LimoStatus"
    after = fields.size
    members = (_Member * 6)(
        _Member(name=b"header", type_id=_MESSAGE, members=ctypes.addressof(introspection)),
        _Member(name=b"vehicle_state", type_id=_UINT8, offset=after),
        _Member(name=b"control_mode", type_id=_UINT8, offset=after + 1),
        _Member(name=b"battery_voltage", type_id=_DOUBLE, offset=after + 8),
        _Member(name=b"error_code", type_id=_UINT16, offset=after + 16),
        _Member(name=b"motion_mode", type_id=_UINT8, offset=after + 18),
    )
    table = _Members(b"limo_msgs__msg", b"LimoStatus", len(members), after + 24, False, members, fields.functions)
    handles = {_FAST_DDS: _copy(fast, callbacks, hash_), _INTROSPECTION: _copy(introspection, table, hash_)}
    generic = _copy(donor, callbacks, hash_)
    handles[_GENERIC] = generic

    def find(_: int | None, identifier: bytes) -> int | None:
        handle = handles.get(identifier)
        return None if handle is None else ctypes.addressof(handle)

    generic.find = found_by = _Find(find)
    _forever.extend((name, digest, hash_, callbacks, members, table, handles, found_by))
    capsule = api.PyCapsule_New(ctypes.addressof(generic), name, None)
    functions = ("_CREATE_ROS_MESSAGE", "_CONVERT_FROM_PY", "_CONVERT_TO_PY", "_DESTROY_ROS_MESSAGE")
    meta_class = type("Metaclass_LimoStatus", (type,), {f: getattr(meta, f) for f in functions})
    meta_class._TYPE_SUPPORT = capsule  # type: ignore[attr-defined]
    return meta_class("LimoStatus", (), {})
