"""A process that looks at the ROS graph and reports what it saw.

A middleware may hang, crash or print as it likes: here the doctor survives it.
"""

from __future__ import annotations

import base64
import os
import pickle
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from rosplc.bridge.ros_side import RosSide, choose_backend
from rosplc.config import Project, load_project
from rosplc.doctor.graph import Graph
from rosplc.errors import BackendError, RosplcError
from rosplc.ros import ROS1, open_backend, settled_graph
from rosplc.ros.names import join, resolve_topic

NODE = "rosplc_doctor"
_PROGRAM = "from rosplc.doctor.look import main; main()"
_START_S = 30.0  # how long the process may take beyond its look: imports, joining, leaving
_LONGEST_WORDS = 200


def see_graph(config: Path, seconds: float, variables: Mapping[str, str]) -> Graph:
    """Look at the ROS graph of a configuration in another process, for at most so many seconds.

    Raises BackendError as the middleware or the backend; TimeoutError: it did not end in time, and was
    killed.
    """
    command = [sys.executable, "-c", _PROGRAM, str(config), str(seconds)]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, env=dict(variables)
    )
    try:
        out, noise = process.communicate(timeout=seconds + _START_S)
    except subprocess.TimeoutExpired:
        raise TimeoutError(f"the look at the graph did not end within {seconds + _START_S:g} s") from None
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()
    lines = noise.decode("utf-8", "replace").strip().splitlines()
    words = lines[-1].strip()[:_LONGEST_WORDS] if lines else ""
    try:
        # Written by this module, in a process of our own; a library may have printed something before it.
        answer = pickle.loads(base64.b64decode(out.rpartition(b"\n")[2], validate=True))
    except (ValueError, EOFError, pickle.UnpicklingError):
        what = f"the look at the graph ended with status {process.returncode}: {words or 'it said nothing'}"
        raise BackendError("ROS002", what) from None
    if isinstance(answer, Graph):
        return answer
    # What the library wrote would otherwise be lost with the process.
    library = f" (the library: {words})" if words and answer["code"] == "ROS002" else ""
    what = f"{answer['what']}{library}"
    raise BackendError(answer["code"], what, where=answer["where"], remedy=answer["remedy"])


def _look(project: Project, seconds: float) -> Graph:
    side = RosSide(project.config)
    settings = project.config.settings.ros
    environment = side.environment()
    choice = choose_backend(project.config, environment)
    own, namespace, remap = side.names()
    backend = open_backend(
        choice.name,
        project.store,
        NODE,
        namespace,
        settings.domain,
        remap=remap,
        environment=environment,
        options=side.options(choice.name),
    )
    try:
        info = settled_graph(backend.graph, seconds)
    finally:
        backend.close()
    names = {
        name: resolve_topic(name, namespace=namespace, node_name=own, remap=remap)
        for name in (*(plan.topic for plan in project.topics), *(call.called for call in project.calls))
    }
    where = f"domain {environment.get('ROS_DOMAIN_ID') or 0 if settings.domain is None else settings.domain}"
    if settings.distro == ROS1:
        where = f"the graph of {environment.get('ROS_MASTER_URI') or 'http://localhost:11311'}"
    return Graph(choice.name, info, names, join(namespace, own), where)


def main() -> None:
    """Write what is seen, or the error as plain data, to stdout."""
    # Libraries write to stdout as they like; the answer goes to where stdout was.
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    try:
        seen: Graph | dict[str, str] = _look(load_project(sys.argv[1]), float(sys.argv[2]))
    except RosplcError as error:
        seen = error.to_dict()
    answer.write(b"\n" + base64.b64encode(pickle.dumps(seen)))
    answer.flush()
    # Threads of a middleware may be in the way of an ordinary end.
    os._exit(0)
