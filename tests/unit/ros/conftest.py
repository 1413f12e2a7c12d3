"""What several tests of backends use."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.interop.graphs import Graph, free_domain


@pytest.fixture
def graph() -> Iterator[Graph]:
    with free_domain() as domain:
        graph = Graph("dds", domain)
        yield graph
        graph.close()
