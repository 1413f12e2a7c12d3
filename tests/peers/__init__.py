"""Releases that are in the field, as peers of what is in this tree; each from its own sources."""
