"""rclpy/exceptions.py."""

from __future__ import annotations

from rclpy._handles import InvalidHandle

__all__ = ["InvalidHandle"]


class NotInitializedException(Exception):
    pass


class NameValidationException(Exception):
    pass


class InvalidTopicNameException(NameValidationException):
    pass


class InvalidNodeNameException(NameValidationException):
    pass


class InvalidNamespaceException(NameValidationException):
    pass


class ParameterException(Exception):
    pass


class ParameterNotDeclaredException(ParameterException):
    pass


class ParameterAlreadyDeclaredException(ParameterException):
    pass


class ParameterImmutableException(ParameterException):
    pass


class InvalidParameterValueException(ParameterException):
    pass
