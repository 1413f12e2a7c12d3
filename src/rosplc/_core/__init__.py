"""The C core. shm, codec and layout import it from here, where the import contracts see it."""

from rosplc._core._native import Fault as Fault
from rosplc._core._native import Group as Group
from rosplc._core._native import Plan as Plan
from rosplc._core._native import Reader as Reader
from rosplc._core._native import Region as Region
from rosplc._core._native import Shape as Shape
from rosplc._core._native import Sink as Sink
from rosplc._core._native import SlotInfo as SlotInfo
from rosplc._core._native import View as View
from rosplc._core._native import Writer as Writer
from rosplc._core._native import beat as beat
from rosplc._core._native import check_identity as check_identity
from rosplc._core._native import distance as distance
from rosplc._core._native import next_sequence as next_sequence
