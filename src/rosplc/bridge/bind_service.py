"""A service between the PLC and a user's own program, which has ROS' place: nothing else is needed."""

from __future__ import annotations

import itertools
import json
import queue
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from threading import Lock
from typing import Any

from rosplc.bridge.engine import Bridge
from rosplc.codec import Codec, Wire
from rosplc.config import parse_config, resolve
from rosplc.errors import ChannelError
from rosplc.layout import RecordView
from rosplc.ros import SERVICES, Reply, memory

_domains = itertools.count(1 << 20)


@contextmanager
def bind_service(
    service: str,
    type: str,
    handler: Callable[[RecordView], Mapping[str, Any]] | None = None,
    **settings: Any,
) -> Iterator[Callable[..., RecordView]]:
    """Carry a service in a bridge's place, until the block ends; its value calls the PLC.

    ``call(request, timeout=5.0)`` returns the response, or raises ChannelError: SHM140, the call was not
    carried out and never will be; SHM141, it may have been.

    Args:
        service: As ROS writes it, ``"/cell/start"``.
        type: ``"package/srv/Name"``.
        handler: Carries out what the PLC calls, in another thread: it is given the request and returns the
            response; if it raises, the PLC gets none. Without one the PLC serves.
        settings: Further keys of the configuration: ``prefix="cell1"``, ``limits={"string": 40}``.

    Raises:
        ConfigErrors: As in a configuration.
        ChannelError: SHM116 if a bridge or another program holds a name; SHM117 ….
    """
    what = {service: {"type": type, "server": "ros" if handler else "plc"}}
    project = resolve(
        parse_config(json.dumps({"diagnostics": {"enabled": False}, **settings, "services": what}))
    )
    plan, store, domain, one = project.services[0], project.store, next(_domains), Lock()
    ask, answer = (Codec(layout, Wire.CDR) for layout in (plan.request, plan.response))
    with (
        closing(memory.open_backend(store, "bind", domain=domain)) as side,
        closing(memory.open_backend(store, "program", domain=domain)) as program,
        Bridge(project, side) as bridge,
    ):

        def on_request(payload: bytes, caller: bytes, _: int) -> None:
            assert handler is not None
            response = handler(ask.layout.view(ask.decode(payload)))
            server.reply(caller, answer.encode(answer.layout.pack(response)))

        def state() -> tuple[int, int, int]:
            (found,) = bridge.status().services
            return sum(found.not_executed.values()), sum(found.fate_unknown.values()), found.outstanding

        def call(request: Mapping[str, Any], timeout: float = 5.0) -> RecordView:
            replies: queue.SimpleQueue[Reply] = queue.SimpleQueue()
            payload = ask.encode(ask.layout.pack(request))
            with one:
                before, ends = state(), time.monotonic() + timeout
                number = client.call(payload, replies.put)
                while (after := state())[:2] == before[:2] and time.monotonic() < ends:
                    with suppress(queue.Empty):
                        if (response := replies.get(timeout=0.01).payload) is not None:
                            return answer.layout.view(answer.decode(response))
                client.forget(number)
            # While a call before it is open, that may be the one that was refused.
            refused = after[0] > before[0] and not before[2]
            code, how = ("SHM140", "not executed") if refused else ("SHM141", "fate unknown")
            raise ChannelError(code, f"the call ended as {how}", where=service)

        if handler:
            server = program.serve(service, type, SERVICES, on_request)
        else:
            client = program.client(service, type, SERVICES)
        yield call
