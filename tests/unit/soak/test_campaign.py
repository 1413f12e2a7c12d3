"""A campaign's seed decides what happens when."""

from __future__ import annotations

from itertools import islice
from types import SimpleNamespace
from typing import Any

from tests.soak.campaign import Campaign
from tests.soak.faults import FAULTS


def test_a_seed_repeats_the_order() -> None:
    """The same seed draws the same faults, and a later round can be drawn without the ones before."""
    cell: Any = SimpleNamespace(backend="dds", plc="python", private=True)
    orders = []
    for first in (1, 30):
        rounds = Campaign(cell, FAULTS, 7, print).drawn(first)
        orders.append([(number, fault.name, dice.random()) for number, fault, dice in islice(rounds, 60)])
    assert orders[0][29:] == orders[1][:31]
    assert orders[0] != [(number, name, 0.0) for number, name, _ in orders[1]]


def test_every_kind_comes_before_one_comes_again() -> None:
    """Rare faults come as often as others."""
    cell: Any = SimpleNamespace(backend="dds", plc="python", private=True)
    campaign = Campaign(cell, FAULTS, 8, print)
    kinds = len(campaign.outcome.faults)
    names = [fault.name for _, fault, _ in islice(campaign.drawn(), 2 * kinds)]
    assert set(names[:kinds]) == set(names[kinds:]) == set(campaign.outcome.faults)
