"""The type store: bundled types, added ones, fingerprints."""

from __future__ import annotations

from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_typestore

from rosplc.errors import MessageTypeError
from rosplc.model import DISTROS, NamedType, TypeStore
from rosplc.model.store import _EVERY_ROS2 as EVERY_ROS2
from rosplc.model.store import _SINCE_JAZZY as SINCE_JAZZY

STORES = {
    "humble": Stores.ROS2_HUMBLE,
    "jazzy": Stores.ROS2_JAZZY,
    "kilted": Stores.ROS2_KILTED,
    "lyrical": Stores.ROS2_LYRICAL,
    "noetic": Stores.ROS1_NOETIC,
}
# As rosidl generates them: kilted's packages as micro-ROS ships them in hpmicro/hpm_sdk
# (files *__description.c), all 156 common types of which were compared once.
PUBLISHED_HASHES = {
    "std_msgs/msg/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "std_msgs/msg/Char": "3ad2d04dd29ba19d04b16659afa3ccaedd691914b02a64e82e252f2fa6a586a9",
    "std_msgs/msg/Empty": "20b625256f32d5dbc0d04fee44f43c41e51c70d3502f84b4a08e7a9c26a96312",
    "std_msgs/msg/ByteMultiArray": "972fec7f50ab3c1d06783c228e79e8a9a509021708c511c059926261ada901d4",
    "geometry_msgs/msg/Twist": "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
    "sensor_msgs/msg/JointState": "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    "service_msgs/msg/ServiceEventInfo": "41bcbbe07a75c9b52bc96bfd5c24d7f0fc0a08c0cb7921b3373c5732345a6f45",
    "rcl_interfaces/msg/ParameterDescriptor": (
        "52175dbfda6c51153101d33d2a9da05743f66f02d5ab2ca9ec4709b46b73d704"
    ),
}


@pytest.mark.parametrize("distro", DISTROS)
def test_every_bundled_type_survives_its_own_definition_text(distro: str) -> None:
    """A self-description's text gives the same type, text and fingerprints again."""
    store = TypeStore.bundled(distro)
    assert len(store) >= 150
    for name in store.names():
        text = store.definition_text(name)
        again = TypeStore.from_definition(name, text, distro=distro)
        assert again[name] == store[name]
        assert again.definition_text(name) == text
        assert again.type_hash(name) == store.type_hash(name)
        assert again.md5(name) == store.md5(name)


@pytest.mark.parametrize("distro", DISTROS)
def test_fingerprints_agree_with_rosbags(distro: str) -> None:
    """Hashes and MD5 sums are rosbags' own, but for type hashes where a char is involved."""
    store, other = TypeStore.bundled(distro), get_typestore(STORES[distro])
    for name in other.fielddefs:
        assert store.md5(name) == other.generate_msgdef(name)[1]
        has_char = any(
            "char" in str(field.type).split("[")[0].split("/")
            for needed in store.dependencies(name)
            for field in store[needed].fields
        )
        assert (store.type_hash(name) == other.hash_rihs01(name)) is not has_char


PUBLISHED_MD5 = {
    "turtlesim/Pose": "863b248d5016ca62ea2e895ae5265cf9",
    "turtlesim/Color": "353891e354491c51aabe32df673fb446",
    "tf2_msgs/TFMessage": "94810edda583a504dfda3829e70d7eec",
    "tf2_msgs/TF2Error": "bc6848fd6fd750c92e38575618a4917d",
    "tf/tfMessage": "94810edda583a504dfda3829e70d7eec",
    "map_msgs/OccupancyGridUpdate": "b295be292b335c34718bd939deebe1c9",
    "map_msgs/PointCloud2Update": "6c58e4f249ae9cd2b24fb1ee0f99195e",
    "map_msgs/ProjectedMap": "7bbe8f96e45089681dc1ea7d023cbfca",
    "map_msgs/ProjectedMapInfo": "2dc10595ae94de23f22f8a6d2a0eef7a",
    "pcl_msgs/ModelCoefficients": "ca27dea75e72cb894cd36f9e5005e93e",
    "pcl_msgs/PointIndices": "458c7998b7eaf99908256472e273b3d4",
    "pcl_msgs/PolygonMesh": "45a5fc6ad2cde8489600a790acc9a38a",
    "pcl_msgs/Vertices": "39bd7b1c23763ddd1b882b97cb7cfe11",
}


def test_types_of_a_desktop_installation() -> None:
    """Those that rosbags lacks have the published checksums, and ROS 2 has them as well."""
    store = TypeStore.bundled("noetic")
    assert {name: store.md5(name) for name in PUBLISHED_MD5} == PUBLISHED_MD5
    for distro in ("humble", "jazzy", "kilted", "lyrical"):
        ros2 = TypeStore.bundled(distro)
        names = (name for name in PUBLISHED_MD5 if not name.startswith("tf/"))
        assert all(name in ros2 for name in names)
        array = ros2["example_interfaces/Float64MultiArray"]
        assert [str(field.type) for field in array.fields] == [
            "example_interfaces/msg/MultiArrayLayout",
            "float64[]",
        ]
        assert "example_interfaces/Header" not in ros2
        assert "pendulum_msgs/RttestResults" in ros2


def test_ros_1_byte_is_signed() -> None:
    """A byte is an int8 in ROS 1 and is hashed as it is written; in ROS 2 it is unsigned."""
    ros1, ros2 = TypeStore.bundled("noetic"), TypeStore.bundled("jazzy")
    assert ros1["std_msgs/Byte"].fields[0].type.name == "int8"  # type: ignore[union-attr]
    assert ros2["std_msgs/Byte"].fields[0].type.name == "byte"  # type: ignore[union-attr]
    assert ros1.definition_text("std_msgs/Byte") == "byte data\n"
    own = ros1.with_definition("a/A", "byte X=200\nbyte[2] b\n")
    assert own["a/A"].constants[0].value == -56
    assert own.definition_text("a/A") == "byte X=200\nbyte[2] b\n"


def test_type_hashes_are_the_published_ones() -> None:
    """Type hashes are those that rosidl generates, also for char and for empty messages."""
    store = TypeStore.bundled("kilted")
    for name, digest in PUBLISHED_HASHES.items():
        assert store.type_hash(name) == f"RIHS01_{digest}"


def test_md5_uses_the_text_of_constants() -> None:
    """ROS 1 hashes a constant as it is written: 0x1 and 1 differ."""
    texts = ("uint8 A=0x1\nint8 x\n", "uint8 A=1\nint8 x\n", "uint8  A = 1 # one\n\nint8   x\n")
    sums = [TypeStore.from_definition("a/B", text, distro="noetic").md5("a/B") for text in texts]
    assert sums[0] != sums[1] == sums[2]


def test_definition_text_of_each_ros_version() -> None:
    """ROS 1 writes time by that name and without a definition, ROS 2 as a message."""
    noetic = TypeStore.bundled("noetic").definition_text("std_msgs/Header")
    assert noetic == "uint32 seq\ntime stamp\nstring frame_id\n"
    jazzy = TypeStore.bundled("jazzy").definition_text("std_msgs/Header")
    assert jazzy == (
        "builtin_interfaces/Time stamp\nstring frame_id\n"
        + "=" * 80
        + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    )


def test_definition_text_names_types_in_order_of_first_use() -> None:
    """Each needed type appears once, depth first."""
    text = TypeStore.bundled("jazzy").definition_text("geometry_msgs/PoseStamped")
    names = [line[5:] for line in text.splitlines() if line.startswith("MSG: ")]
    assert names == [
        "std_msgs/Header", "builtin_interfaces/Time", "geometry_msgs/Pose", "geometry_msgs/Point",
        "geometry_msgs/Quaternion",
    ]  # fmt: skip


def test_dependencies_come_before_what_needs_them() -> None:
    """A type's dependencies end with itself, and each stands after its own."""
    store = TypeStore.bundled("jazzy")
    order = store.dependencies("nav_msgs/Odometry")
    assert order[-1] == "nav_msgs/msg/Odometry"
    for position, name in enumerate(order):
        needed = {f.type.name for f in store[name].fields if isinstance(f.type, NamedType)}
        assert needed <= set(order[:position])


@pytest.mark.parametrize(
    ("distro", "w", "status"),
    [
        ("humble", 1.0, None),
        ("jazzy", 1.0, -2),
        ("kilted", 1.0, -2),
        ("lyrical", 1.0, -2),
        ("noetic", None, None),
    ],
)
def test_bundled_defaults_are_the_distributions(distro: str, w: float | None, status: int | None) -> None:
    """A Quaternion's w is 1 in ROS 2 only, and NavSatStatus has a default since jazzy."""
    store = TypeStore.bundled(distro)
    assert {f.name: f.default for f in store["geometry_msgs/Quaternion"].fields}["w"] == w
    assert {f.name: f.default for f in store["sensor_msgs/NavSatStatus"].fields}["status"] == status


@pytest.mark.parametrize("distro", ["humble", "jazzy", "kilted", "lyrical"])
def test_every_default_is_of_a_field(distro: str) -> None:
    """The table of default values cannot fall out of step with the bundled types."""
    store = TypeStore.bundled(distro)
    for name, values in (EVERY_ROS2 if distro == "humble" else SINCE_JAZZY).items():
        found = {field.name: field.default for field in store[name].fields if field.default is not None}
        assert found == values


def test_names_are_accepted_in_both_forms() -> None:
    """pkg/Name and pkg/msg/Name name the same type; other things are not in the store."""
    store = TypeStore.bundled("jazzy")
    assert store["std_msgs/String"] is store["std_msgs/msg/String"]
    assert "std_msgs/String" in store
    for name in ("String", "std_msgs/srv/String", "std_msgs/Strnig", "", "a" * 1000, None, 5):
        assert name not in store


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("geometry_msgs/Twit", "geometry_msgs/msg/Twist"),
        ("geometry_msgs/JointState", "sensor_msgs/msg/JointState"),
        ("Twist", "geometry_msgs/msg/Twist"),
        ("geometry_msgs/twist", "geometry_msgs/msg/Twist"),
        ("what/is/this/Twist", "not a type name"),
    ],
)
def test_unknown_types_get_a_hint(name: str, hint: str) -> None:
    """A misspelt type is refused with the nearest known one."""
    with pytest.raises(MessageTypeError, match=hint) as caught:
        TypeStore.bundled("jazzy")[name]
    assert caught.value.code == "TYP001"


def test_unknown_distributions_get_a_hint() -> None:
    """A misspelt distribution is refused with the nearest known one."""
    with pytest.raises(MessageTypeError, match="jazzy") as caught:
        TypeStore.bundled("jazy")
    assert caught.value.code == "TYP006"


def test_adding_types_leaves_the_old_store_alone() -> None:
    """Stores do not change: adding makes a new one."""
    old = TypeStore.bundled("jazzy")
    new = old.with_definition("my_msgs/Pair", "geometry_msgs/Point a\ngeometry_msgs/Point b\n")
    assert "my_msgs/Pair" in new
    assert "my_msgs/Pair" not in old
    assert new.distro == "jazzy"


def test_definitions_off_the_wire_keep_known_defaults() -> None:
    """The same type without its default values is no conflict, and the defaults stay."""
    store = TypeStore.bundled("jazzy")
    text = "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
    assert (
        store.with_definition("geometry_msgs/Quaternion", text)["geometry_msgs/Quaternion"].fields[3].default
        == 1
    )
    other = store.with_definition("geometry_msgs/Quaternion", text.replace("w", "w 0.5"))
    assert other["geometry_msgs/Quaternion"].fields[3].default == 0.5


def test_other_constants_are_a_conflict() -> None:
    """A type whose constants differ is another definition, though its fields are the same."""
    text = "byte OK=1\nstring name\n"
    store = TypeStore.from_definition("a/A", text)
    assert store.with_definition("a/A", f"# copy\n{text}")["a/A"] == store["a/A"]
    with pytest.raises(MessageTypeError) as caught:
        store.with_definition("a/A", text.replace("1", "2"))
    assert caught.value.code == "TYP005"


def test_ros1_times_need_no_definition() -> None:
    """The types time and duration are known where the text does not define them."""
    store = TypeStore.from_definition("a/A", "time t\nduration[] d\n", distro="noetic")
    assert store.ros_version == 1
    assert store.definition_text("a/A") == "time t\nduration[] d\n"
    assert store.dependencies("a/A")[:2] == ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")


@pytest.mark.parametrize("text", ["A again\n", "A[] again\n", f"B b\n{'=' * 80}\nMSG: a/B\nA[2] a\n"])
def test_types_that_contain_themselves_are_refused(text: str) -> None:
    """Recursion is an error that shows the cycle, whichever way it goes."""
    with pytest.raises(MessageTypeError, match="→") as caught:
        TypeStore.from_definition("a/A", text)
    assert caught.value.code == "TYP003"


@pytest.mark.parametrize(
    ("name", "remedy"),
    [
        ("my_msgs/msg/Part", "ROS installs it in /opt/ros/DISTRO/share/my_msgs."),
        ("sensor_msgs/msg/Imagery", "`rosplc types sensor_msgs` lists its types"),
    ],
)
def test_an_unknown_type_comes_with_what_to_do(name: str, remedy: str) -> None:
    """A package that is not bundled has a folder somewhere; one that is has a list."""
    with pytest.raises(MessageTypeError) as caught:
        TypeStore.bundled("jazzy")[name]
    assert caught.value.code == "TYP001" and remedy in caught.value.remedy


class TestFolders:
    """Custom types from files."""

    @pytest.fixture
    def root(self, tmp_path: Path) -> Path:
        for file, text in {
            "one_msgs/msg/First.msg": "two_msgs/Second second\nfloat64 w 1\n",
            "two_msgs/Second.msg": "int32 x\n",
            "deep/er/three_msgs/msg/Third.msg": "one_msgs/First[] many\n",
        }.items():
            (tmp_path / file).parent.mkdir(parents=True)
            (tmp_path / file).write_text(text)
        return tmp_path

    def test_each_way_of_arranging_files(self, root: Path) -> None:
        """Packages with and without a msg folder are found at any depth."""
        store = TypeStore.bundled("jazzy").with_paths([root])
        assert {"one_msgs/First", "two_msgs/Second", "three_msgs/Third"} <= {
            name.replace("/msg/", "/") for name in store.names()
        }
        assert store["one_msgs/First"].fields[1].default == 1.0

    def test_a_package_folder_and_a_file(self, root: Path) -> None:
        """A package's own folder, its msg folder and a single file are accepted as well."""
        second = root / "two_msgs/Second.msg"
        for path in (root / "one_msgs", root / "one_msgs/msg"):
            assert "one_msgs/First" in TypeStore.bundled("jazzy").with_paths([path, second])

    def test_the_manifest_names_the_package(self, root: Path) -> None:
        """The name in package.xml counts, not the folder's."""
        (root / "two_msgs/package.xml").write_text("<package format='3'><name>real_msgs</name></package>")
        store = TypeStore.bundled("jazzy").with_paths([root / "two_msgs"])
        assert "real_msgs/Second" in store

    def test_equal_copies_are_no_conflict(self, root: Path, tmp_path: Path) -> None:
        """The same definition in a source and an install folder is one type."""
        copy = root / "install/one_msgs/msg"
        copy.mkdir(parents=True)
        (copy / "First.msg").write_text("# copied\ntwo_msgs/Second   second\nfloat64 w 1\n")
        assert "one_msgs/First" in TypeStore.bundled("jazzy").with_paths([root])

    @pytest.mark.parametrize(
        ("file", "text", "code", "where", "what"),
        [
            ("one_msgs/msg/Bad.msg", b"int32 a\nint32 a\n", "TYP002", "Bad.msg:2", "twice"),
            (
                "one_msgs/msg/Bad.msg",
                b"int32 a\ntwo_msgs/Secnd s",
                "TYP001",
                "Bad.msg:2",
                "two_msgs/msg/Second",
            ),
            ("one_msgs/msg/Bad.msg", b"Bad a", "TYP003", "Bad.msg", "Bad → "),
            ("one_msgs/msg/Bad.msg", b"wstring a", "TYP004", "Bad.msg:1", "wstring"),
            ("one_msgs/msg/Bad.msg", b"int32 a\n# \xff\n", "TYP002", "Bad.msg:2", "UTF-8"),
            ("one_msgs/msg/Bad.msg", b"#" * (1 << 20) + b"#", "TYP007", "Bad.msg", "bytes"),
            ("z/one_msgs/First.msg", b"int8 x", "TYP005", "z/one_msgs/First.msg", "differs from"),
            ("std_msgs/msg/String.msg", b"string text", "TYP005", "String.msg", "that of jazzy"),
            ("9msgs/msg/Bad.msg", b"int8 x", "TYP002", "Bad.msg", "package name"),
            ("one_msgs/msg/No-Name.msg", b"int8 x", "TYP002", "No-Name.msg", "message name"),
            ("one_msgs/package.xml", b"<package>", "TYP002", "package.xml", "manifest"),
        ],
    )
    def test_errors_name_file_and_line(
        self, root: Path, file: str, text: bytes, code: str, where: str, what: str
    ) -> None:
        """Every mistake in a file is reported with its path, and its line where there is one."""
        (root / file).parent.mkdir(parents=True, exist_ok=True)
        (root / file).write_bytes(text)
        store = TypeStore.bundled("jazzy").with_paths([root])
        error = store.problems()[0]
        assert (error.code, what in error.what, where in error.where) == (code, True, True)
        for name in {"one_msgs/Bad", "std_msgs/String", "one_msgs/First", "msgs/Bad"} - set(store.names()):
            package, _, base = name.partition("/")
            if f"{package}/msg/{base}" in store.names():
                assert store[name]
                continue
            with pytest.raises(MessageTypeError) as caught:
                _ = store[name]
            assert caught.value.code in (code, "TYP001")
        assert store["two_msgs/Second"]

    def test_folders_may_need_each_other(self, tmp_path: Path) -> None:
        """Order does not decide, and packages that use each other may be in different folders."""
        for file, text in {
            "a/one_msgs/msg/A.msg": "two_msgs/B b\n",
            "b/two_msgs/msg/B.msg": "one_msgs/C c\n",
            "a/one_msgs/msg/C.msg": "int32 x\n",
        }.items():
            (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / file).write_text(text)
        for order in (["a", "b"], ["b", "a"]):
            store = TypeStore.bundled("jazzy").with_paths(tmp_path / each for each in order)
            assert store.dependencies("one_msgs/A")[-1] == "one_msgs/msg/A"

    def test_only_what_is_used_must_be_sound(self, root: Path) -> None:
        """One type with a mistake makes no other unusable; what needs it is refused with file and line."""
        (root / "one_msgs/msg/Wide.msg").write_text("wstring text\n")
        (root / "one_msgs/msg/Needs.msg").write_text("int8 x\nWide wide\n")
        (root / "one_msgs/msg/Lacks.msg").write_text("int8 x\nnowhere_msgs/Type y\n")
        store = TypeStore.bundled("jazzy").with_paths([root])
        assert store["three_msgs/Third"] and store["std_msgs/String"]
        for name, code, where in (
            ("Wide", "TYP004", "Wide.msg:1"),
            ("Needs", "TYP004", "Wide.msg:1"),
            ("Lacks", "TYP001", "Lacks.msg:2"),
        ):
            with pytest.raises(MessageTypeError) as caught:
                _ = store[f"one_msgs/{name}"]
            assert (caught.value.code, where in caught.value.where) == (code, True)
            assert f"one_msgs/msg/{name}" not in store.names()
        assert [error.code for error in store.problems()] == ["TYP001", "TYP004", "TYP004"]

    def test_ignored_folders_of_a_workspace_are_left_out(self, root: Path) -> None:
        """What colcon builds, and hidden folders, hold copies that may be old."""
        for folder in ("build", ".git"):
            (root / folder / "one_msgs/msg").mkdir(parents=True)
            (root / folder / "one_msgs/msg/First.msg").write_text("int8 old\n")
        (root / "build/COLCON_IGNORE").touch()
        store = TypeStore.bundled("jazzy").with_paths([root])
        assert store.problems() == ()
        assert store["one_msgs/First"].fields[0].name == "second"

    def test_a_folder_without_definitions_is_an_error(self, tmp_path: Path) -> None:
        """A misspelt or empty folder does not pass for one without types."""
        (tmp_path / "file.txt").write_text("int8 x")
        (tmp_path / "empty").mkdir()
        for path in (tmp_path / "missing", tmp_path / "empty", tmp_path / "file.txt"):
            with pytest.raises(MessageTypeError) as caught:
                TypeStore.bundled("jazzy").with_paths([path])
            assert caught.value.code == "TYP008"
