"""The versions of the package, and of the shared-memory format (spec/CHANGES.md)."""

__version__ = "0.2.0"
FORMAT = "1.1"
