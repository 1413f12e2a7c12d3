"""ROS messages, services and actions: bundled with a distribution, custom, or from a self-description."""

from rosplc.model.store import DISTROS as DISTROS
from rosplc.model.store import TypeStore as TypeStore
from rosplc.model.types import ArrayType as ArrayType
from rosplc.model.types import FieldType as FieldType
from rosplc.model.types import MessageType as MessageType
from rosplc.model.types import NamedType as NamedType
from rosplc.model.types import PrimitiveType as PrimitiveType
from rosplc.model.types import SequenceType as SequenceType
from rosplc.model.types import StringType as StringType
