"""From a robot, or a recording of one, to a configuration: what is there, what to carry, how much room."""

__all__: list[str] = []
