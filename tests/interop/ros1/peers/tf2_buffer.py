"""What Debian's tf2 finds: a line of stdin has transforms and lookups, one of stdout the answers."""

import json
import sys

import genpy
import tf2_py
from geometry_msgs.msg import TransformStamped


def _fill(buffer, static, child, parent, stamp_ns, pose):
    message = TransformStamped()
    message.header.stamp = genpy.Time(0, stamp_ns)
    message.header.frame_id, message.child_frame_id = parent, child
    translation, rotation = message.transform.translation, message.transform.rotation
    translation.x, translation.y, translation.z = pose[:3]
    rotation.x, rotation.y, rotation.z, rotation.w = pose[3:]
    (buffer.set_transform_static if static else buffer.set_transform)(message, "test")


def _look_up(buffer, target, source):
    try:
        found = buffer.lookup_transform_core(target, source, genpy.Time())
    except tf2_py.TransformException as error:
        return type(error).__name__
    translation, rotation = found.transform.translation, found.transform.rotation
    pose = [translation.x, translation.y, translation.z, rotation.x, rotation.y, rotation.z, rotation.w]
    return [found.header.stamp.to_nsec(), pose]


for line in sys.stdin:
    transforms, lookups = json.loads(line)
    buffer = tf2_py.BufferCore(genpy.Duration(10))
    for transform in transforms:
        _fill(buffer, *transform)
    print(json.dumps([_look_up(buffer, *pair) for pair in lookups]))
