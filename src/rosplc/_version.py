"""The package's version; the shared-memory format has its own (spec/CHANGES.md)."""

__version__ = "0.1.0"
