"""For pictures of the views: a bridge, a service and an action that a virtual PLC carries out for a robot."""

from __future__ import annotations

import queue
import signal
import subprocess
import sys
import tempfile
import threading
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rosplc.codec import Codec, Wire
from rosplc.demo.plan import FreeDomain
from rosplc.layout import compute_layout
from rosplc.model import TypeStore
from rosplc.ros import SERVICES, ActionClient, GoalEvent, open_backend
from rosplc.virtual_plc import ActionServer, ServiceServer, VirtualPlc

SERVICE, ACTION = "/gripper/close", "/cell/count"
TRIGGER, FIBONACCI = "std_srvs/srv/Trigger", "example_interfaces/action/Fibonacci"
CONFIG = f"""\
bridge: cell1
prefix: {{prefix}}
ros: {{{{distro: jazzy, backend: dds, domain: {{domain}}}}}}
services:
  {SERVICE}: {{{{type: {TRIGGER}, server: plc}}}}
actions:
  {ACTION}: {{{{type: {FIBONACCI}, server: plc}}}}
"""
SCANS_OF_A_GOAL = 800


def plc(prefix: str) -> VirtualPlc:
    """Return a PLC that answers calls at once, and carries a goal out for some seconds."""
    machine = VirtualPlc()
    task = machine.task("MainTask", interval=0.01)
    close, count = ServiceServer(SERVICE, prefix=prefix), ActionServer(ACTION, prefix=prefix)
    scans = 0

    @task.program
    def main() -> None:
        nonlocal scans
        close()
        if close.xRequest:
            close.response.success, close.response.message = True, "closed with 40 N"
        close.xReply = close.xRequest
        count()
        scans = scans + 1 if count.xActive else 0
        count.xAccept = count.xGoal
        count.xSendFeedback = scans % 20 == 1
        if count.xActive:
            count.feedback.sequence = count.result.sequence = [0, 1, 1, 2, 3, 5, 8, 13, 21][: 1 + scans // 90]
        count.xSucceed = scans > SCANS_OF_A_GOAL

    return machine


def robot(domain: int, stopped: threading.Event) -> None:
    """Call the service twice a second, and send a goal whenever none is carried out."""
    store = TypeStore.bundled("jazzy")
    request, goal = (
        codec.encode(codec.layout.pack({} if part.endswith("Request") else {"order": 8}))
        for part in (f"{TRIGGER}_Request", f"{FIBONACCI}_Goal")
        for codec in [Codec(compute_layout(store, part), Wire.CDR)]
    )
    node = open_backend("dds", store, "robot", domain=domain)
    service, events = node.client(SERVICE, TRIGGER, SERVICES), queue.Queue[GoalEvent]()
    action, busy = ActionClient(node, store, ACTION, FIBONACCI, events.put), False
    while not stopped.wait(0.5):
        if service.ready:
            service.call(request, lambda reply: None)
        if action.ready and not busy:
            action.send(uuid.uuid4().bytes, goal)
            busy = True
        while not events.empty():
            busy = busy and events.get().kind not in ("result", "rejected", "failed")
    node.close()


@contextmanager
def calling_cell(prefix: str) -> Iterator[None]:
    """Have the bridge, the PLC and the robot run."""
    domain, stopped = FreeDomain(), threading.Event()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rosplc.yaml"
        path.write_text(CONFIG.format(prefix=prefix, domain=domain.number), encoding="utf-8")
        command = [sys.executable, "-m", "rosplc", "run", str(path)]
        bridge = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        machine, caller = plc(prefix), threading.Thread(target=robot, args=(domain.number, stopped))
        try:
            machine.start()
            caller.start()
            yield
        finally:
            stopped.set()
            caller.join()
            machine.stop()
            bridge.send_signal(signal.SIGINT)
            bridge.wait()
            for file in Path("/dev/shm").glob(f"{prefix}.*"):
                file.unlink()
