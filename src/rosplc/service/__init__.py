"""A bridge as a service of systemd: its unit, its user, and what it reports to the service manager."""

__all__: list[str] = []
