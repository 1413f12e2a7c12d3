"""A bridge as a systemd service: its unit, its user, and its reports to the service manager."""

__all__: list[str] = []
