"""The cases of the layout vectors: one per feature, hostile ones included."""

from __future__ import annotations

__all__ = ["CASES", "SIZES", "TIME"]

SIZES = {"bool": 1, "byte": 1, "char": 1, "int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int32": 4}
SIZES |= {"uint32": 4, "int64": 8, "uint64": 8, "float32": 4, "float64": 8}
TIME = "int32 sec\nuint32 nanosec\n"
SEPARATOR = "=" * 80 + "\n"


def msg(name, text):
    """Return a further type of a definition."""
    return f"{SEPARATOR}MSG: {name}\n{text}"


def deeper(letter, level, last):
    """Return the type of the next level, or the innermost type."""
    return f"{letter}{level + 1}" if level < 9 else last


ALL = "".join(f"{name} {name}_value\n" for name in SIZES)
LOWEST = {
    f"{name}_value": -(2 ** (8 * size - 1)) if name.startswith("int") else 0
    for name, size in SIZES.items()
    if name not in ("bool", "float32", "float64")
}
HIGHEST = {
    f"{name}_value": 2 ** (8 * size - name.startswith("int")) - 1
    for name, size in SIZES.items()
    if name not in ("bool", "float32", "float64")
}
LOWEST |= {"bool_value": False, "float32_value": -0.0, "float64_value": -1.7976931348623157e308}
HIGHEST |= {"bool_value": True, "float32_value": 3.4028234663852886e38, "float64_value": 5e-324}

HEADER2 = msg("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n")
TIME2 = msg("builtin_interfaces/Time", TIME)
VECTOR3 = msg("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n")
QUATERNION = "float64 x 0.0\nfloat64 y 0.0\nfloat64 z 0.0\nfloat64 w 1.0\n"
MULTIARRAY = (
    msg("std_msgs/MultiArrayLayout", "MultiArrayDimension[] dim\nuint32 data_offset\n")
    + msg("std_msgs/MultiArrayDimension", "string label\nuint32 size\nuint32 stride\n")
)  # fmt: skip
_WORDS = (
    "int for while struct union register volatile linux errno NULL bool true_ class template "
    "VAR END_VAR IF THEN ELSIF END_IF PROGRAM STRING REAL LREAL BOOL ARRAY OF AT MOD AND OR NOT "
    "TIME DATE ACTION SUPER THIS ADR SIZEOF DINT lambda from import None self"
)
C_AND_ST_WORDS = _WORDS.split()
INNER = msg("vector/Inner", "uint8 kind\nfloat64[] data\nstring[] labels\n")

CASES = {
    "primitives": {"type": "vector/Primitives", "definition": ALL, "values": [LOWEST, HIGHEST]},
    "primitives_reversed": {
        "type": "vector/Reversed",
        "definition": "".join(reversed(ALL.splitlines(True))),
        "values": [HIGHEST],
    },
    "padding_everywhere": {
        "type": "vector/Padding",
        "definition": "bool a\nfloat64 b\nint8 c\nint16 d\nuint8 e\nint32 f\nbool g\nuint64 h\nuint8 i\n",
        "values": [{"a": True, "b": 1.5, "c": -1, "d": -2, "e": 3, "f": -4, "g": True, "h": 5, "i": 6}],
    },
    "empty": {"type": "vector/Empty", "definition": "", "values": [{}]},
    "empty_only_constants": {
        "type": "vector/Level",
        "definition": "byte OK=0\nbyte WARN=1\n",
        "values": [{}],
    },
    "empty_nested": {
        "type": "vector/Holder",
        "definition": "uint8 before\nEmpty nothing\nuint16 after\nEmpty[3] three\nEmpty[] many\n"
        + msg("vector/Empty", ""),
        "limits": {"sequence": 5},
        "values": [{"before": 1, "nothing": {}, "after": 2, "three": [{}, {}, {}], "many": [{}, {}]}],
    },
    "constants": {
        "type": "vector/Constants",
        "definition": "int32 X=-5\nstring NAME=\"a # b\"\nfloat32 HALF=0.5\nint32 value\n",
        "values": [{"value": 7}],
    },
    "strings": {
        "type": "vector/Strings",
        "definition": "string plain\nstring<=5 bounded\nstring<=200 wide\nstring small\nuint16 after\n",
        "limits": {"string": 20, "fields": {"small": 1, "wide": 7}},
        "values": [
            {"plain": "hello", "bounded": "12345", "wide": "seven 7", "small": "x", "after": 1},
            {"plain": "äöü €", "bounded": "", "wide": "\U0001f916", "small": "", "after": 2},
        ],
    },
    "sequences": {
        "type": "vector/Sequences",
        "definition": "uint8[] a\nuint16[<=3] b\nfloat64[] c\nbool[] d\nint32[<=40] e\nint64[] f\n",
        "limits": {"sequence": 4, "fields": {"c": 2, "e": 1, "f": 3}},
        "values": [
            {"a": [1, 2, 3], "b": [65535], "c": [0.25, -0.5], "d": [True, False], "e": [-1], "f": []},
            {"a": [], "b": [1, 2, 3], "c": [], "d": [True] * 4, "e": [], "f": [1, 2, -(2**63)]},
        ],
    },
    "arrays": {
        "type": "vector/Arrays",
        "definition": "uint8[3] a\nfloat64[2] b\nbool[5] c\nstring[2] d\nPoint[2] e\nint16[1] f\n"
        + msg("vector/Point", "float32 x\nuint8 tag\n"),
        "limits": {"fields": {"d[]": 4}},
        "values": [
            {"a": [1, 2, 3], "b": [1.0, 2.0], "c": [True, False, True, False, True], "d": ["ab", "cdef"],
             "e": [{"x": 0.5, "tag": 1}, {"x": -0.5, "tag": 2}], "f": [-3]},
        ],
    },
    "strings_in_sequences": {
        "type": "vector/Texts",
        "definition": "string[] free\nstring<=3[] short\nstring[<=2] few\nstring<=3[<=2] both\nuint8 end\n",
        "limits": {"sequence": 3, "string": 6, "fields": {"free": 4, "free[]": 10, "both": 1, "both[]": 2}},
        "values": [
            {"free": ["", "0123456789"], "short": ["abc", "", "x"], "few": ["ä", "ß"], "both": ["zz"],
             "end": 9}
        ],
    },
    "structs_with_sequences": {
        "type": "vector/Outer",
        "definition": "Inner[2] pair\nInner[] many\nInner one\n" + INNER,
        "limits": {
            "sequence": 2, "string": 5,
            "fields": {"pair[].data": 3, "many": 4, "many[].labels": 1, "many[].labels[]": 9, "one.data": 7},
        },
        "values": [
            {"pair": [{"kind": 1, "data": [1.0, 2.0, 3.0], "labels": ["a", "b"]},
                      {"kind": 2, "data": [], "labels": []}],
             "many": [{"kind": 3, "data": [4.0], "labels": ["nine char"]}],
             "one": {"kind": 4, "data": [0.5] * 7, "labels": ["x"]}},
        ],
    },
    "same_type_other_limits": {
        "type": "vector/Twice",
        "definition": "Inner left\nInner right\n" + INNER,
        "limits": {"fields": {"left.data": 1, "right.data": 2, "right.labels[]": 3, "left.labels": 1}},
        "values": [{"left": {"kind": 1, "data": [1.0], "labels": ["l"]},
                 "right": {"kind": 2, "data": [1.0, 2.0], "labels": ["r", "abc"]}}],
    },
    "nested_ten_deep": {
        "type": "vector/L0",
        "definition": "uint8 head\nL1 below\nuint8 tail\n"
        + "".join(
            msg(f"vector/L{level}", f"uint8 head\n{deeper('L', level, 'float64')} below\nuint8 tail\n")
            for level in range(1, 10)
        ),
        "values": [{"head": 1, "below": {"below": {"below": {"tail": 3}}, "tail": 2}}],
    },
    "nested_ten_deep_in_arrays": {
        "type": "vector/A0",
        "definition": "A1[2] below\nuint8 tail\n"
        + "".join(
            msg(f"vector/A{level}", f"{deeper('A', level, 'uint16')}[] below\nuint8 tail\n")
            for level in range(1, 10)
        ),
        "limits": {"sequence": 1},
        "values": [{"below": [{"tail": 1}, {"below": [{"below": [{"tail": 3}], "tail": 2}]}], "tail": 9}],
    },
    "hostile_names": {
        "type": "vector/Names",
        "definition": "".join(f"uint8 {word}\n" for word in C_AND_ST_WORDS)
        + "string[] items\nuint32 items_count\nuint8 padding_1\nuint16 n_items\n",
        "limits": {"sequence": 2, "string": 3},
        "values": [{"int": 1, "VAR": 2, "from": 3, "items": ["a"], "items_count": 77, "padding_1": 5}],
    },
    "names_differ_in_case": {
        "type": "vector/Case",
        "definition": "uint8 value\nfloat64 Value\nint16 VALUE\nstring[] vALUE\n",
        "limits": {"fields": {"vALUE": 1, "vALUE[]": 2}},
        "values": [{"value": 1, "Value": 2.0, "VALUE": -3, "vALUE": ["ok"]}],
    },
    "defaults": {
        "type": "vector/Defaults",
        "definition": "bool on true\nint8 low -128\nuint64 high 18446744073709551615\nfloat32 half 0.5\n"
        'float64 big 1e300\nstring text "über \\"all\\""\nint16[3] three [1, -2, 3]\n'
        'uint8[] some [7, 8]\nstring[] words ["a, b", "c"]\nbool[2] flags [true, false]\nint32 plain\n',
        "limits": {"sequence": 3, "string": 12},
        "values": [{}, {"some": [], "words": ["z"], "text": ""}],
    },
    "defaults_nested": {
        "type": "geometry_msgs/Poses",
        "definition": "geometry_msgs/Quaternion one\ngeometry_msgs/Quaternion[2] two\n"
        "geometry_msgs/Quaternion[] many\n" + msg("geometry_msgs/Quaternion", QUATERNION),
        "limits": {"sequence": 2},
        "values": [{"many": [{}]}, {"one": {"w": 0.0, "z": 1.0}, "many": [{"x": 1.0}, {"w": -1.0}]}],
    },
    "ros1_header": {
        "type": "vector/Ros1",
        "definition": "Header header\ntime at\nduration[] spans\n"
        + msg("std_msgs/Header", "uint32 seq\ntime stamp\nstring frame_id\n"),
        "ros_version": 1,
        "limits": {"sequence": 2, "fields": {"header.frame_id": 8}},
        "values": [{"header": {"seq": 5, "stamp": {"sec": 7, "nanosec": 8}, "frame_id": "map"},
                 "at": {"sec": -1, "nanosec": 4294967295}, "spans": [{"sec": 1, "nanosec": 2}]}],
    },
    "twist": {
        "type": "geometry_msgs/Twist",
        "definition": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n" + VECTOR3,
        "values": [{"linear": {"x": 0.5, "y": 0.0, "z": -0.25}, "angular": {"x": 0.0, "y": 0.0, "z": 1.5}}],
    },
    "joint_state": {
        "type": "sensor_msgs/JointState",
        "definition": "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n"
        "float64[] effort\n" + HEADER2 + TIME2,
        "limits": {"fields": {"name": 6, "name[]": 20, "position": 6, "velocity": 6, "effort": 6}},
        "values": [{"header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "base"}, "name": ["j1", "j2"],
                 "position": [0.1, 0.2], "velocity": [], "effort": [9.81]}],
    },
    "multiarray": {
        "type": "std_msgs/Float64MultiArray",
        "definition": "std_msgs/MultiArrayLayout layout\nfloat64[] data\n" + MULTIARRAY,
        "limits": {"fields": {"layout.dim": 2, "layout.dim[].label": 7, "data": 6}},
        "values": [{"layout": {"dim": [{"label": "height", "size": 2, "stride": 6},
                                    {"label": "width", "size": 3, "stride": 3}], "data_offset": 0},
                 "data": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]}],
    },
    "multiarray_bytes": {
        "type": "std_msgs/ByteMultiArray",
        "definition": "std_msgs/MultiArrayLayout layout\nbyte[] data\n" + MULTIARRAY,
        "limits": {"sequence": 1, "string": 1, "fields": {"data": 5}},
        "values": [{"data": [0, 1, 127, 128, 255]}],
    },
}  # fmt: skip
