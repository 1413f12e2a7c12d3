"""Transforms as a configuration asks for them: topics to the PLC that the bridge itself fills."""

from __future__ import annotations

import enum

TF_MESSAGE = "tf2_msgs/msg/TFMessage"  # what ROS nodes publish
TYPE_NAME = "rosplc/msg/Transform"  # what the PLC gets
DEFINITION = """\
geometry_msgs/Transform transform  # the frame `source` in the frame `target`
uint32 age_ms  # how old it was when the bridge wrote it, by the bridge's clock; static: 0
uint32 error  # why there is no pose; 0: there is one
bool is_static  # every transform of the chain is static
string frame  # what the error is about; without an error the frame whose transform is the oldest
"""
FRAME_BYTES = 80  # of a frame's name in the PLC; what exceeds it is cut


class TransformError(enum.IntEnum):
    """Why the PLC has no valid pose; the frame named beside it is what each is about."""

    NONE = 0
    NO_BRIDGE = 1  # the bridge does not run, or is silent
    UNKNOWN_FRAME = 2  # no transform has named this frame
    NOT_CONNECTED = 3  # the chain from the source does not lead to the target; it ends at this frame
    NO_COMMON_TIME = 4  # the chain is not known for any one time; this frame's transform lacks it
    TOO_OLD = 5  # the pose is older than `max_age`; this frame's transform is the oldest
    LOOP = 6  # this frame is its own ancestor: several nodes publish its parents
