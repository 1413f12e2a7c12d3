"""How much room strings and sequences get."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from rosplc.errors import LayoutError

if TYPE_CHECKING:
    from collections.abc import Mapping


MAX_STRING = 65534  # Largest capacity of a string in bytes.
MAX_SEQUENCE = 1 << 24  # Largest capacity of a sequence in elements.


@dataclass(frozen=True)
class Limits:
    """Capacities of one topic's strings and sequences (spec/type-mapping.md, section 2).

    Attributes:
        string: Bytes of every string that ``fields`` does not name.
        sequence: Elements of every sequence that ``fields`` does not name.
        fields: Capacity by field path, such as ``{"name": 6, "name[]": 20}``.

    Raises:
        LayoutError: LAY001, a capacity is no whole number or out of range.
    """

    string: int = 80
    sequence: int = 16
    fields: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _check(self.string, MAX_STRING, "string")
        _check(self.sequence, MAX_SEQUENCE, "sequence")
        for path, capacity in self.fields.items():
            _check(capacity, MAX_SEQUENCE, path)
        object.__setattr__(self, "fields", dict(sorted(self.fields.items())))

    def __hash__(self) -> int:
        return hash((self.string, self.sequence, tuple(self.fields.items())))

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, as a self-description stores it."""
        return {"string": self.string, "sequence": self.sequence, "fields": dict(self.fields)}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Limits:
        """Return the limits that :meth:`to_dict` wrote; the data is not trusted.

        Raises LayoutError: LAY001, the data has another form or a capacity is not valid.
        """
        fields = data.get("fields", {})
        unknown = set(data) - {"string", "sequence", "fields"}
        if unknown or not isinstance(fields, dict) or not all(isinstance(path, str) for path in fields):
            raise LayoutError("LAY001", "limits are not of the form {string, sequence, fields}")
        return cls(data.get("string", 80), data.get("sequence", 16), fields)


def _check(capacity: object, largest: int, where: str) -> None:
    # bool is an int to Python, and `yes` in a configuration is a mistake, not a 1.
    if not isinstance(capacity, int) or isinstance(capacity, bool) or not 1 <= capacity <= largest:
        raise LayoutError("LAY001", f"capacity {capacity!r} is not within 1 … {largest}", where=where)
