"""Elements of ``std_msgs/*MultiArray`` by their indices.

These messages hold all elements in one sequence, and say in ``layout`` where each dimension
lies: element ``[i, j, k]`` is ``data[data_offset + dim[1].stride * i + dim[2].stride * j + k]``
(std_msgs/msg/MultiArrayLayout).
"""

from __future__ import annotations

from typing import Any

from rosplc.errors import LayoutError


def multiarray_index(message: Any, *indices: int) -> int:
    """Return the position of an element within ``message.data``.

    Args:
        message: A view of a MultiArray message, or any object like it.
        indices: One per dimension, each from 0.

    Raises:
        LayoutError: LAY006, wrong number of indices, one outside its dimension, or a message
            whose strides lead outside of its data.
    """
    dimensions = message.layout.dim
    if len(indices) != len(dimensions):
        raise LayoutError("LAY006", f"{len(indices)} indices for {len(dimensions)} dimensions")
    for axis, (index, dimension) in enumerate(zip(indices, dimensions, strict=True)):
        if not 0 <= index < dimension.size:
            what = f"index {index} is not within 0 … {dimension.size - 1}"
            raise LayoutError("LAY006", what, where=f"layout.dim[{axis}]")
    # The stride of a dimension counts all that lies below, itself included: use the next one's.
    strides = [dimension.stride for dimension in dimensions[1:]] + [1]
    position: int = message.layout.data_offset
    position += sum(index * stride for index, stride in zip(indices, strides, strict=False))
    if not 0 <= position < len(message.data):
        what = f"the strides lead to element {position} of {len(message.data)}"
        raise LayoutError("LAY006", what, where="layout")
    return position
