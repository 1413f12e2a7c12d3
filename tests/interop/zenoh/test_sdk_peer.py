"""The Zenoh backend and zenoh-ros2-sdk, an independent implementation: values, both ways."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("zenoh")
pytest.importorskip("zenoh_ros2_sdk")

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rosplc.model import TypeStore
from rosplc.ros import Backend, Qos, open_backend
from tests.interop.graphs import wait_for
from tests.interop.zenoh.processes import Router, free_port

pytestmark = pytest.mark.timeout(120)

DOMAIN = 11
CUSTOM = "cell_msgs/msg/State"
DEFINITIONS = {
    "std_msgs/msg/String": "string data\n",
    "std_msgs/msg/Float64": "float64 data\n",
    CUSTOM: "int32 number\nfloat64[] values\nstring name\nbool[3] flags\nuint8[] raw\n",
}
VALUES: dict[str, list[dict[str, Any]]] = {
    "std_msgs/msg/String": [{"data": f"message {i}"} for i in range(5)],
    "std_msgs/msg/Float64": [{"data": i / 3} for i in range(5)],
    CUSTOM: [
        {
            "number": -i,
            "values": [i / 7, 1e300],
            "name": "x" * i,
            "flags": [True, False, True],
            "raw": [i, 255],
        }
        for i in range(5)
    ],
}
KINDS = {"values": np.float64, "flags": np.bool_, "raw": np.uint8}

# The oracle for values: another implementation of CDR, by another project.
ORACLE = get_typestore(Stores.ROS2_JAZZY)
ORACLE.register(get_types_from_msg(DEFINITIONS[CUSTOM], CUSTOM))


def serialized(kind: str, fields: dict[str, Any]) -> bytes:
    made = {k: np.array(v, KINDS[k]) if k in KINDS else v for k, v in fields.items()}
    data = bytes(ORACLE.serialize_cdr(ORACLE.types[kind](**made), kind))
    return data + bytes(-len(data) % 4)


@pytest.fixture
def port() -> Iterator[int]:
    with free_port() as number, Router(number):
        yield number


@pytest.fixture(params=["peer", "client"])
def node(request: pytest.FixtureRequest, port: int) -> Iterator[Backend]:
    store = TypeStore.bundled("jazzy").with_definition(CUSTOM, DEFINITIONS[CUSTOM])
    options = {"mode": request.param, "connect": [f"tcp/127.0.0.1:{port}"]}
    backend = open_backend("zenoh", store, "cell", domain=DOMAIN, options=options, environment={})
    yield backend
    backend.close()


@contextlib.contextmanager
def sdk(port: int, role: str, kind: str, values: object, qos: str = "") -> Iterator[subprocess.Popen[str]]:
    script = str(Path(__file__).with_name("sdk_peer.py"))
    command = [sys.executable, script, str(port), str(DOMAIN), role, "/data", kind, DEFINITIONS[kind], qos]
    pipe = subprocess.PIPE
    with subprocess.Popen([*command, json.dumps(values)], stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout is not None
        try:
            for line in process.stdout:
                if line.strip() == "ready":
                    break
            yield process
        finally:
            # Killed, it would leave a segment of the library's in /dev/shm.
            assert process.stdin is not None
            process.stdin.close()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(10)
            process.kill()


@pytest.mark.parametrize("kind", DEFINITIONS)
def test_values_from_the_sdk(node: Backend, port: int, kind: str) -> None:
    """What the SDK publishes arrives value by value, from a type hash that both computed themselves."""
    got: list[bytes] = []
    subscription = node.subscribe("/data", kind, Qos(depth=100), lambda data, _: got.append(data))
    with sdk(port, "pub", kind, VALUES[kind]) as peer:
        wait_for(lambda: subscription.matched == 1)
        assert peer.stdin is not None

        while len(got) < 5:  # the way changes while peers connect, and what is under way then is lost
            peer.stdin.write("go\n")
            peer.stdin.flush()
            time.sleep(0.2)
        expected = [serialized(kind, fields) for fields in VALUES[kind]]
        assert [data + bytes(-len(data) % 4) for data in got[:5]] == expected
    wait_for(lambda: subscription.matched == 0)
    assert subscription.status().rejected == 0


@pytest.mark.parametrize("kind", DEFINITIONS)
def test_values_to_the_sdk(node: Backend, port: int, kind: str) -> None:
    """What the backend publishes arrives at the SDK value by value, in order."""
    publisher = node.advertise("/data", kind, Qos(depth=100))
    first, *rest = VALUES[kind]
    heard: list[dict[str, Any]] = []
    with sdk(port, "sub", kind, list(first)) as peer:
        assert peer.stdout is not None
        thread = threading.Thread(target=lambda: heard.extend(map(json.loads, peer.stdout)), daemon=True)
        thread.start()
        wait_for(lambda: publisher.matched == 1)
        while not heard:  # the way changes while peers connect, and what is under way then is lost
            assert publisher.write(serialized(kind, first))
            time.sleep(0.05)
        for fields in rest:
            assert publisher.write(serialized(kind, fields))
        wait_for(lambda: heard[-1] == rest[-1])
    assert [fields for fields in heard if fields != first] == rest
