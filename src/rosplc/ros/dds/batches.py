"""The test that decides whether C code (``batch.c``) passes messages without Python work for each one."""

from __future__ import annotations

import functools
import logging
import os
from importlib.metadata import version
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl import types as idl_types
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from rosplc.errors import BackendError
from rosplc.ros.dds import _batch, native

RELEASE = "11.0.1"
"""The release of the cyclonedds wheel whose functions ``batch.c`` declares; no other release is used."""

_logger = logging.getLogger("rosplc.ros.dds")

# A domain of its own, in which nobody is discovered.
_ALONE = (
    '<CycloneDDS><Domain id="any"><General><AllowMulticast>false</AllowMulticast><Interfaces>'
    '<NetworkInterface address="127.0.0.1"/></Interfaces></General><Discovery><Tag>rosplc_trial_{}</Tag>'
    "<ParticipantIndex>none</ParticipantIndex></Discovery><Tracing><Verbosity>none</Verbosity></Tracing>"
    "</Domain></CycloneDDS>"
)
_SAMPLE = b"\0\1\0\0\x05\0\0\0trial\0\0\0"  # five octets, padded to whole words
_STAMP = 1_234_567_890_123_456_789
_WAIT_NS = 5_000_000_000
_DOMAIN = 199


@functools.cache
def obstacle() -> str:
    """Return why batches are not used in this process; empty if they are. The first call runs a test."""
    found, why = version("cyclonedds"), ""
    if found != RELEASE:
        why = f"batch processing in C requires cyclonedds {RELEASE}, but {found} is installed"
    if not why:
        try:
            _batch.load(native.library._name)
            why = _trial()
        except (OSError, DDSException, BackendError) as error:
            why = f"the self-test of batch processing in C failed: {error}"
    if not why:
        _logger.info("messages are processed in batches in C; the self-test with cyclonedds %s passed", found)
        return ""
    why = f"messages are processed one by one, which uses more CPU: {why}"
    _logger.warning("%s", why)
    return why


def _trial() -> str:
    """Send and receive a known message; return the reason for a failure, or an empty text."""
    entities: list[Any] = [Domain(_DOMAIN, _ALONE.format(os.getpid()))]
    try:
        participant = DomainParticipant(_DOMAIN)
        data_type = make_idl_struct("Trial", "rosplc.Trial", {"data": idl_types.sequence[idl_types.uint8]})
        topic = Topic(participant, "trial", data_type)
        reader, writer = DataReader(participant, topic), DataWriter(participant, topic)
        entities += [participant, topic, reader, writer]
        sender, refusing = _batch.Outlet(writer._ref), _batch.Outlet(writer._ref)
        sender.open(len(_SAMPLE), 0)
        refusing.open(0, 0)
        inlet, waitset = _batch.Inlet(), native.WaitSet(participant._ref)
        inlet.add(0, reader._ref, refusing.capsule)
        condition = waitset.attach(reader._ref, 0)
        sent = sender.write(_SAMPLE, _STAMP)
        came = inlet.wait(waitset.ref, 2, _WAIT_NS)
        waitset.detach(condition)
        waitset.close()
    finally:
        for entity in reversed(entities):
            native.delete(entity)
    right = sent and came == ([], [(0, _SAMPLE, _STAMP)]) and sender.messages == 1
    return "" if right else "the self-test of batch processing in C did not receive the message that it sent"
