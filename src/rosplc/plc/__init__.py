"""The PLC half, written from a layout: constants, types and code that a technician imports."""

__all__: list[str] = []
