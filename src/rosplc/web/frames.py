"""What is sent to one page: the difference between what it has and what there is."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rosplc.web.feed import Feed
    from rosplc.web.wants import Wants

__all__ = ["Frames"]


class Frames:
    """Makes the frames for one page.

    A frame has only what is new: ``channels`` (whole ones that are new to the page, else the members
    that differ), ``gone``, ``bridges``, ``notes``, ``events``, ``messages`` and ``samples``.

    Args:
        feed: What there is.
    """

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self._document: dict[str, Any] | None = None
        self._channels: dict[str, dict[str, Any]] = {}
        self._event = 0
        self._messages: dict[str, int] = {}
        self._sample = 0
        self._failure = ""

    def next(self, wants: Wants) -> dict[str, Any] | None:
        """Return the next frame; None if nothing is new."""
        frame: dict[str, Any] = {}
        self._add_picture(frame)
        events = [(number, event) for number, event in self._feed.events if number > self._event]
        if events:
            frame["events"] = [{"number": number, **event} for number, event in events]
            self._event = events[-1][0]
        self._add_messages(frame, wants)
        self._add_samples(frame, wants)
        if self._feed.failure != self._failure:
            frame["failure"] = self._failure = self._feed.failure
        return frame or None

    def _add_picture(self, frame: dict[str, Any]) -> None:
        document = self._feed.document
        if document is None or document is self._document:
            return
        before = self._document or {}
        frame["time_ms"] = document["time_ns"] / 1e6
        changed = {}
        for channel, members in self._feed.channels.items():
            known = self._channels.get(channel, {})
            differs = {name: value for name, value in members.items() if known.get(name, ...) != value}
            if differs:
                changed[channel] = differs
        if changed:
            frame["channels"] = changed
        gone = [channel for channel in self._channels if channel not in self._feed.channels]
        if gone:
            frame["gone"] = gone
        for name in ("bridges", "notes"):
            if before.get(name) != document[name]:
                frame[name] = document[name]
        self._document, self._channels = document, self._feed.channels

    def _add_messages(self, frame: dict[str, Any], wants: Wants) -> None:
        found = {}
        for channel in wants.messages:
            number, message = self._feed.messages.get(channel, (0, {}))
            if number > self._messages.get(channel, 0):
                self._messages[channel] = number
                found[channel] = message
        for channel in self._messages.keys() - wants.messages:
            del self._messages[channel]
        if found:
            frame["messages"] = found

    def _add_samples(self, frame: dict[str, Any], wants: Wants) -> None:
        found: dict[str, dict[str, list[Any]]] = {}
        newest = self._sample
        for channel, paths in wants.plots.items():
            series = [each for each in self._feed.samples.get(channel, ()) if each[0] > self._sample]
            if not series:
                continue
            newest = max(newest, series[-1][0])
            found[channel] = {
                "t": [time_ms for _, time_ms, _ in series],
                **{f"v:{path}": [values.get(path) for _, _, values in series] for path in sorted(paths)},
            }
        if found:
            self._sample = newest
            frame["samples"] = found
