"""Which DDS domains have nodes, seen without joining them."""

from __future__ import annotations

import socket
import threading

from rosplc.init.live import _GROUP, domains_in_use, elsewhere


def test_a_program_of_this_machine_is_seen_by_its_socket(tmp_path) -> None:
    """The kernel's list of sockets names discovery's port of domain 7; other ports say nothing."""
    (tmp_path / "net").mkdir()
    rows = ["  sl  local_address rem_address", f"  1: 00000000:{7400 + 250 * 7:04X} 0:0", "  2: 0:1CE9 0:0"]
    (tmp_path / "net/udp").write_text("\n".join(rows))
    assert domains_in_use(0.0, tmp_path) == {7}


def test_a_packet_of_another_machine_is_heard(tmp_path) -> None:
    """Discovery by multicast shows the domain, other packets do not."""
    stop = threading.Event()

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            udp.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
            while not stop.wait(0.02):
                udp.sendto(b"RTPS\x02\x02", (_GROUP, 7400 + 250 * 93))
                udp.sendto(b"else", (_GROUP, 7400 + 250 * 94))

    thread = threading.Thread(target=send)
    thread.start()
    try:
        found: set[int] = set()
        for _ in range(60):
            found |= domains_in_use(1.0, tmp_path)
            if found:
                break
    finally:
        stop.set()
        thread.join()
    assert 93 in found and 94 not in found


def test_the_hint_names_other_domains_only(monkeypatch) -> None:
    """The domain that was looked at is no hint, and a ROS master has no domain."""
    monkeypatch.setattr("rosplc.init.live.domains_in_use", lambda seconds: {0, 42})
    assert "domain 42:" in elsewhere("domain 0 (backend dds)")
    assert elsewhere("the graph of http://localhost:11311") == ""
