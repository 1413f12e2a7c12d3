"""What rmw_cyclonedds does for services and topics, in plain Cyclone DDS; no code of rosplc is in it.

Written from ``rmw_node.cpp`` and ``serdata.hpp``: the header before the fields, the ids in the user data,
how a client finds a server, and how a server waits for a client's reader.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from typing import Any

from cyclonedds.core import Policy
from cyclonedds.core import Qos as DdsQos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl.types import int64, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

HEADER: dict[str, Any] = {"rmw_client_id": uint64, "rmw_call_number": int64}


def message_class(type_name: str, **fields: Any) -> Any:
    """Return the class of a message, named as ROS names it: ``package/srv/Name_Request``."""
    package, part, name = type_name.split("/")
    made = make_idl_struct(f"{name}_", f"{package}.{part}.dds_.{name}_", fields)
    made.__idl_annotations__["extensibility"] = "final"
    return made


class RmwNode:
    """A participant of rmw_cyclonedds.

    Args:
        domain: The ROS domain.
        topics: Returns what opens a participant's topics; each of its own, if not given.
    """

    def __init__(self, domain: int, topics: Callable[[Any], Any] | None = None) -> None:
        self.participant = DomainParticipant(domain)
        self.topics = topics(self.participant) if topics else lambda *names: Topic(self.participant, *names)
        self._numbers = itertools.count(1)

    def ids(self, role: str = "") -> DdsQos:
        """Return the settings of the two endpoints of a client or server; without a role, of a topic's."""
        octets = self.participant.guid.bytes[:12] + next(self._numbers).to_bytes(4, "big")
        text = f"{octets[0]:2x}" + "".join(f".{octet:x}" for octet in octets[1:])
        return DdsQos(
            Policy.Reliability.Reliable(10**9),
            Policy.History.KeepLast(10),
            Policy.DataRepresentation(use_cdrv0_representation=True),
            *([Policy.Userdata(f"{role}={text};".encode())] if role else []),
        )

    def latched(self) -> DdsQos:
        """Return the settings of an action's topic of statuses."""
        return DdsQos(
            Policy.Reliability.Reliable(10**9),
            Policy.History.KeepLast(1),
            Policy.Durability.TransientLocal,
            Policy.DataRepresentation(use_cdrv0_representation=True),
        )

    def writer(self, topic: str, kind: Any, qos: DdsQos) -> DataWriter[Any]:
        """Open a writer."""
        return DataWriter(self.participant, self.topics(topic, kind), qos)

    def reader(self, topic: str, kind: Any, qos: DdsQos) -> DataReader[Any]:
        """Open a reader."""
        return DataReader(self.participant, self.topics(topic, kind), qos)


def user_data(endpoint: Any) -> dict[str, str]:
    """Return what an endpoint announces beside its settings."""
    text = "" if endpoint is None else bytes(endpoint.qos[Policy.Userdata].data).decode()
    return dict(part.split("=", 1) for part in text.split(";") if "=" in part)


def taken(reader: DataReader[Any]) -> list[Any]:
    """Return what has come, without the news of endpoints that have gone."""
    return [one for one in reader.take(100) if one.sample_info.valid_data]


class RmwClient:
    """What rmw_create_client makes; the reply reader may come later, to see what a server does then."""

    def __init__(self, node: RmwNode, service: str, kinds: tuple[Any, Any], *, complete: bool = True) -> None:
        self._node, self._service, self._qos = node, service, node.ids("clientid")
        self._request, self._response = kinds
        self.writer = node.writer(f"rq{service}Request", self._request, self._qos)
        self.guid = self.writer.get_instance_handle() % 2**64
        self._sequence = itertools.count(1)
        if complete:
            self.complete()

    def complete(self) -> None:
        """Open the reader."""
        self.reader = self._node.reader(f"rr{self._service}Reply", self._response, self._qos)

    def available(self) -> bool:
        """Return what rmw_service_server_is_available does (check_for_service_reader_writer)."""
        readers = map(self.writer.get_matched_subscription_data, self.writer.get_matched_subscriptions())
        wanted = {user_data(one)["serviceid"] for one in readers if "serviceid" in user_data(one)}
        writers = map(self.reader.get_matched_publication_data, self.reader.get_matched_publications())
        return any(user_data(one).get("serviceid") in wanted for one in writers)

    def send(self, *fields: Any) -> int:
        """Send a request; return its number."""
        number = next(self._sequence)
        self.writer.write(self._request(self.guid, number, *fields))
        return number

    def take(self) -> list[Any]:
        """Return the responses to this client (rmw_take_response)."""
        return [one for one in taken(self.reader) if one.rmw_client_id == self.guid]


class RmwServer:
    """What rmw_create_service makes."""

    def __init__(self, node: RmwNode, service: str, kinds: tuple[Any, Any]) -> None:
        qos = node.ids("serviceid")
        request, self._response = kinds
        self.writer = node.writer(f"rr{service}Reply", self._response, qos)
        self.reader = node.reader(f"rq{service}Request", request, qos)

    def take(self) -> list[Any]:
        """Return requests."""
        return taken(self.reader)

    def reached(self, request: Any) -> bool | None:
        """Return whether the client's reader is matched; None if it has gone (check_for_response_reader)."""
        client = self.reader.get_matched_publication_data(request.sample_info.publication_handle)
        if client is None:
            return None
        readers = map(self.writer.get_matched_subscription_data, self.writer.get_matched_subscriptions())
        return user_data(client)["clientid"] in [user_data(one).get("clientid") for one in readers]

    def answer(self, request: Any, *fields: Any) -> None:
        """Answer a request once its client's reader is known; rmw_cyclonedds waits 100 ms, this longer."""
        end = time.monotonic() + 10
        while self.reached(request) is False and time.monotonic() < end:
            time.sleep(0.001)
        if self.reached(request):
            self.writer.write(self._response(request.rmw_client_id, request.rmw_call_number, *fields))
