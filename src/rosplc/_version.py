"""The versions of the package, and of the shared-memory format (spec/CHANGES.md)."""

__version__ = "0.1.0"
FORMAT = "1.1"
