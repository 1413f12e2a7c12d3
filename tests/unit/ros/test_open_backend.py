"""Choosing a backend."""

from __future__ import annotations

import sys

import pytest

from rosplc.errors import BackendError
from rosplc.model import TypeStore
from rosplc.ros import GraphInfo, open_backend, settled_graph
from tests.interop.graphs import LOCAL, free_domain
from tests.lib.clock import SteppedClock

STORE = TypeStore.bundled("jazzy")


def test_unknown_backend_is_refused() -> None:
    """A name that is not a backend is refused, with those that are."""
    with pytest.raises(
        BackendError,
        match=r"unknown backend 'ddz'; use one of auto, dds, rclpy, zenoh, rospy, memory.*ROS001",
    ):
        open_backend("ddz", STORE, "node")


def test_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the wheel the error says what is not installed, and how to install it."""
    for name in [name for name in sys.modules if name.startswith("rosplc.ros.dds")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "cyclonedds", None)
    monkeypatch.setitem(sys.modules, "cyclonedds._clayer", None)
    with pytest.raises(
        BackendError, match=r"the dds backend cannot be imported: .*cyclonedds.*ROS001.*pip install"
    ):
        open_backend("dds", STORE, "node")


def test_automatic_choice_is_opened() -> None:
    """``auto`` opens what was chosen, never the one in memory, and the backend says which."""
    pytest.importorskip("cyclonedds", reason="no wheel of cyclonedds for this machine")
    with free_domain() as domain:
        backend = open_backend("auto", STORE, "node", domain=domain, environment=LOCAL)
        assert backend.name == "dds"
        backend.close()


@pytest.mark.parametrize("domain", ["-1", "x", "233", "1.5", "²"])
@pytest.mark.parametrize("name", ["dds"])
def test_wrong_domain_is_refused(name: str, domain: str) -> None:
    """``ROS_DOMAIN_ID`` that is no domain is refused by its name."""
    pytest.importorskip("cyclonedds", reason="no wheel of cyclonedds for this machine")
    with pytest.raises(BackendError, match=r"ROS_DOMAIN_ID is .*ROS010"):
        open_backend(name, STORE, "node", environment={"ROS_DOMAIN_ID": domain})


def test_ros_1_types_need_another_backend() -> None:
    """The DDS backend refuses the types of ROS 1."""
    pytest.importorskip("cyclonedds", reason="no wheel of cyclonedds for this machine")
    with pytest.raises(BackendError, match=r"noetic is ROS 1.*ROS001"):
        open_backend("dds", TypeStore.bundled("noetic"), "node")


def test_graph_is_settled_once_it_has_not_changed_for_a_second() -> None:
    """A graph that changes is looked at again for a second; without another node, until the time is over."""
    clock, looks = SteppedClock(), []

    def passing(_: int) -> None:
        clock.advance(0.1)

    clock.sleep = passing  # type: ignore[method-assign]

    def graph(nodes: int) -> GraphInfo:
        looks.append(clock.monotonic_ns())
        return GraphInfo(tuple(f"/node{number}" for number in range(min(len(looks), nodes))))

    assert len(settled_graph(lambda: graph(5), 30.0, clock=clock).nodes) == 5
    assert looks[-1] - looks[0] < 3e9
    looks.clear()
    assert settled_graph(lambda: graph(0), 5.0, clock=clock).nodes == ()
    assert looks[-1] - looks[0] >= 5e9
