"""From a robot, or a recording of one, to a configuration: its topics, their directions and limits."""

__all__: list[str] = []
