"""The PLC part, generated from layouts: constants, types and code to import into a PLC project."""

__all__: list[str] = []
