"""Services and actions: their text, the messages that come of it, and fingerprints."""

from __future__ import annotations

from pathlib import Path

import pytest

import rosplc.model.store
from rosplc.errors import MessageTypeError
from rosplc.layout import Limits, compute_layout
from rosplc.model import DISTROS, TypeStore
from rosplc.model.types import ActionType, ServiceType

# As Kilted's packages publish them in share/PACKAGE/{srv,action}/*.json; the action and its messages are
# test_msgs', read from the text below. The first 16 digits; the foreign tier compares all.
FIBONACCI = "int32 order\n---\nint32[] sequence\n---\nint32[] sequence\n"
PUBLISHED_SERVICES = {
    "std_srvs/srv/Empty": "5888399dedec5ccc",
    "std_srvs/srv/SetBool": "abe9e4bb6b41b40e",
    "rcl_interfaces/srv/ListParameters": "3e6062bfbb27bfb8",
    "test_msgs/action/Fibonacci_SendGoal": "d807633803e38e16",
    "test_msgs/action/Fibonacci_GetResult": "5d30fdeb21d20e11",
}
PUBLISHED_MESSAGES = {
    "std_srvs/srv/SetBool_Request": "c62fbb99d94e1b25",
    "std_srvs/srv/SetBool_Response": "d0814e7f7b4880ab",
    "std_srvs/srv/SetBool_Event": "3c4c20015afb4303",
    "test_msgs/action/Fibonacci_Goal": "e58ef5a8f4f039ab",
    "test_msgs/action/Fibonacci_SendGoal_Request": "dfe75c73dc2c090c",
    "test_msgs/action/Fibonacci_GetResult_Response": "ef88159d47a3d21d",
    "test_msgs/action/Fibonacci_GetResult_Event": "fe0aa5843ef10550",
    "test_msgs/action/Fibonacci_FeedbackMessage": "37487bae8cea3583",
}
PUBLISHED_ACTION = "be9273e355722504"
# As ROS 1's tools print them.
PUBLISHED_MD5 = {
    "std_srvs/Empty": "d41d8cd98f00b204e9800998ecf8427e",
    "std_srvs/SetBool": "09fb03525b03e7ea1fd3992bafd87e16",
    "std_srvs/Trigger": "937c9679a518e3a18d831e57125ea522",
    "nav_msgs/GetPlan": "421c8ea4d21c6c9db7054b4bbdf1e024",
    "rospy_tutorials/AddTwoInts": "6a2e34150c00229791cc89ff309fff21",
    "turtlesim/Spawn": "0b2d2e872a8e2887d5ed626f2bf2c561",
    "turtlesim/SetPen": "9f452acce566bf0c0954594f69a8e41b",
    "turtlesim/TeleportAbsolute": "a130bc60ee6513855dc62ea83fcc5b20",
}
PUBLISHED_ACTION_MD5 = {
    "actionlib_tutorials/FibonacciAction": "f59df5767bf7634684781c92598b2406",
    "actionlib_tutorials/FibonacciActionGoal": "006871c7fa1d0e3d5fe2226bf17b2a94",
    "actionlib_tutorials/FibonacciGoal": "6889063349a00b249bd1661df429d822",
    "actionlib_tutorials/action/Fibonacci_Goal": "6889063349a00b249bd1661df429d822",
    "move_base_msgs/MoveBaseAction": "70b6aca7c7f7746d8d1609ad94c80bb8",
}


def custom(root: Path, distro: str = "jazzy", **files: str) -> TypeStore:
    """Return a store with files; ``a__srv__B.srv`` is for ``a/srv/B.srv``."""
    for name, text in files.items():
        file = root / (name.replace("__", "/") + "." + name.split("__")[-2])
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    return TypeStore.bundled(distro).with_paths([root])


def error_of(store: TypeStore, name: str) -> MessageTypeError:
    with pytest.raises(MessageTypeError) as caught:
        store.action(name) if "/action/" in name else store.service(name)
    return caught.value


def names_of(store: TypeStore) -> list[str]:
    """Return the messages of all services and actions."""
    parts = [f"{name}_{part}" for name in store.services() for part in ("Request", "Response")]
    added = ["Goal", "Result", "Feedback"]
    if store.ros_version == 2:
        parts += [f"{name}_Event" for name in store.services()]
        added += [f"{each}_{part}" for each in ("SendGoal", "GetResult") for part in ("Request", "Response")]
        added += ["FeedbackMessage", "SendGoal_Event"]
    return parts + [f"{name}_{part}" for name in store.actions() for part in added]


def test_a_service_and_an_action() -> None:
    """Parts have the fields of the text, and are found by their names as any message is."""
    store = TypeStore.bundled("jazzy")
    service = store.service("std_srvs/SetBool")
    assert service == store.service("std_srvs/srv/SetBool")
    assert service == ServiceType(
        "std_srvs/srv/SetBool", store["std_srvs/srv/SetBool_Request"], store["std_srvs/srv/SetBool_Response"]
    )
    assert [(field.name, str(field.type)) for field in service.response.fields] == [
        ("success", "bool"),
        ("message", "string"),
    ]
    action = store.action("example_interfaces/Fibonacci")
    own = "example_interfaces/action/Fibonacci"
    assert action == ActionType(own, *(store[f"{own}_{part}"] for part in ("Goal", "Result", "Feedback")))
    assert [field.name for field in action.goal.fields] == ["order"]
    assert compute_layout(store, f"{own}_Feedback", Limits(fields={"sequence": 5})).size == 24


def test_what_an_action_adds() -> None:
    """Its services and the message of its feedback have the fields that rosidl gives them."""
    store = TypeStore.bundled("jazzy")
    own = "example_interfaces/action/Fibonacci"
    uuid = ("goal_id", "unique_identifier_msgs/msg/UUID")
    send, get = store.service(f"{own}_SendGoal"), store.service(f"{own}_GetResult")
    for message, fields in (
        (send.request, [uuid, ("goal", f"{own}_Goal")]),
        (send.response, [("accepted", "bool"), ("stamp", "builtin_interfaces/msg/Time")]),
        (get.request, [uuid]),
        (get.response, [("status", "int8"), ("result", f"{own}_Result")]),
        (store[f"{own}_FeedbackMessage"], [uuid, ("feedback", f"{own}_Feedback")]),
    ):
        assert [(field.name, str(field.type)) for field in message.fields] == fields


def test_type_hashes_are_the_published_ones(tmp_path: Path) -> None:
    """Services, actions and their messages have the hashes that rosidl writes."""
    store = custom(tmp_path, "kilted", test_msgs__action__Fibonacci=FIBONACCI)
    assert {name: store.service_hash(name)[7:23] for name in PUBLISHED_SERVICES} == PUBLISHED_SERVICES
    assert {name: store.type_hash(name)[7:23] for name in PUBLISHED_MESSAGES} == PUBLISHED_MESSAGES
    assert store.action_hash("test_msgs/Fibonacci").startswith(f"RIHS01_{PUBLISHED_ACTION}")


def test_md5_sums_are_the_published_ones() -> None:
    """ROS 1's sums of services, and of the messages of actions."""
    store = TypeStore.bundled("noetic")
    assert {name: store.service_md5(name) for name in PUBLISHED_MD5} == PUBLISHED_MD5
    assert {name: store.md5(name) for name in PUBLISHED_ACTION_MD5} == PUBLISHED_ACTION_MD5


@pytest.mark.parametrize("distro", DISTROS)
def test_every_bundled_one_can_be_used(distro: str) -> None:
    """Each has layouts, and its messages survive their own definition text."""
    store = TypeStore.bundled(distro)
    assert len(store.services()) > 25 and len(store.actions()) > 3
    for name in names_of(store):
        compute_layout(store, name)
        again = TypeStore.from_definition(name, store.definition_text(name), distro=distro)
        assert (again[name], again.md5(name)) == (store[name], store.md5(name))
        assert again.type_hash(name) == store.type_hash(name)
    assert not set(store.names()) & set(names_of(store))
    assert store.problems() == ()


def test_nothing_is_parsed_before_it_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Loading a distribution or a folder reads no service; asking for one parses that one, once."""
    asked: list[str] = []
    parse = rosplc.model.store.parse_interface
    monkeypatch.setattr(
        rosplc.model.store,
        "parse_interface",
        lambda name, *a, **k: asked.append(name) or parse(name, *a, **k),
    )
    store = custom(tmp_path, own_msgs__srv__Ask="bool x\n---\n", own_msgs__srv__Wrong="nonsense")
    assert "std_msgs/msg/String" in store and "std_srvs/srv/SetBol" not in store and not asked
    for _ in range(2):
        store.service("own_msgs/Ask")
    assert asked == ["own_msgs/srv/Ask"]


TEXTS = [
    ("srv", 2, "int32 A=1  # one\n\n# of it\nint32 x\n---\n# nothing\n", (["x"], [])),
    ("srv", 2, "---", ([], [])),
    ("srv", 2, "bool a\r\n---\r\nbool b\r\n", (["a"], ["b"])),
    ("action", 2, "---\n---\n", ([], [], [])),
    ("action", 2, "bool a\n---\nbool b\n---\nbool c", (["a"], ["b"], ["c"])),
    # ROS 1 takes every line that begins so, and a service without one.
    ("srv", 1, "bool a\n -----  # answer\nbool b\n", (["a"], ["b"])),
    ("srv", 1, "bool a\n", (["a"], [])),
]


@pytest.mark.parametrize(("kind", "ros", "text", "fields"), TEXTS)
def test_texts(tmp_path: Path, kind: str, ros: int, text: str, fields: tuple[list[str], ...]) -> None:
    """Comments, constants, empty parts and both ends of lines."""
    store = custom(tmp_path, "noetic" if ros == 1 else "jazzy", **{f"own_msgs__{kind}__One": text})
    found = store.service("own_msgs/One") if kind == "srv" else store.action("own_msgs/One")
    parts = [found.request, found.response] if isinstance(found, ServiceType) else []
    parts += [found.goal, found.result, found.feedback] if isinstance(found, ActionType) else []
    assert tuple([field.name for field in part.fields] for part in parts) == fields
    assert [constant.name for constant in parts[0].constants] == (["A"] if "A=1" in text else [])


WRONG = [
    ("own_msgs__srv__One", "bool a\n", "TYP002", 2, "1 × `---` between request, response; found 0"),
    ("own_msgs__srv__One", "bool a\n---\n---\nbool b\n", "TYP002", 3, "response; found 2"),
    ("own_msgs__action__One", "bool a\n---\nbool b\n", "TYP002", 4, "goal, result, feedback; found 1"),
    ("own_msgs__srv__One", "bool a\n---\n\nbool\n", "TYP002", 4, "'bool'"),
    ("own_msgs__srv__One", "bool a\n--- # here\n", "TYP002", 3, "response; found 0"),
    ("own_msgs__srv__One", "bool a\n---\nwstring b\n", "TYP004", 3, "unsupported"),
    ("own_msgs__srv__One", f"---\n{'=' * 80}\nMSG: a/B\nbool b\n", "TYP002", 3, "other types"),
    ("own_msgs__srv__One", "---\nNo[] no\n", "TYP001", 2, "own_msgs/msg/No is unknown"),
]


@pytest.mark.parametrize(("name", "text", "code", "line", "what"), WRONG)
def test_mistakes(tmp_path: Path, name: str, text: str, code: str, line: int, what: str) -> None:
    """An error names file and line; it matters when the service is used, and only then."""
    store = custom(tmp_path, **{name: text, "own_msgs__srv__Good": "---\n"})
    package, kind, base = name.split("__")
    error = error_of(store, f"{package}/{kind}/{base}")
    assert (error.code, error.where) == (code, f"{tmp_path}/{package}/{kind}/{base}.{kind}:{line}")
    assert what in error.what
    assert store.service("own_msgs/Good")
    assert "own_msgs/srv/Good" in store.services() and f"{package}/{kind}/{base}" not in store.services()
    for _ in range(2):
        assert [each.what for each in store.problems()] == [error.what]


def test_folders_of_both_kinds(tmp_path: Path) -> None:
    """A package's own message and Header are found; a folder without srv/ and a single file will do."""
    store = custom(
        tmp_path,
        own_msgs__msg__Header="int32 own\n",
        own_msgs__srv__Ask="Header header\nstd_msgs/Header other\n---\n",
        own_msgs__action__Go="---\n---\n",
    )
    header, other = store.service("own_msgs/Ask").request.fields
    assert (str(header.type), str(other.type)) == ("own_msgs/msg/Header", "std_msgs/msg/Header")
    (tmp_path / "flat_msgs").mkdir()
    (tmp_path / "flat_msgs/Go.action").write_text("---\n---\n")
    (tmp_path / "flat_msgs/no-name.srv").write_text("---\n")
    assert store.with_paths([tmp_path / "flat_msgs/Go.action"]).action("flat_msgs/Go")
    again = store.with_paths([tmp_path])
    assert {"flat_msgs/action/Go", "own_msgs/action/Go"} < set(again.actions())
    assert [error.what for error in again.problems()] == ["'no-name' is not a valid service name"]


def test_two_definitions(tmp_path: Path) -> None:
    """The same one twice is nothing; two that differ are an error when used, as for messages."""
    same = {"one__std_srvs__srv__Trigger": "---\nbool success  # or not\nstring message\n"}
    other = {"two__std_srvs__srv__SetBool": "bool other\n---\nbool success\nstring message\n"}
    store = custom(tmp_path, **same, **other)
    assert store.service("std_srvs/Trigger") == TypeStore.bundled("jazzy").service("std_srvs/Trigger")
    error = error_of(store, "std_srvs/SetBool")
    assert (error.code, error.where) == ("TYP005", str(tmp_path / "two/std_srvs/srv/SetBool.srv"))
    assert error.what == "this definition of std_srvs/srv/SetBool differs from that of jazzy"


def test_what_a_wrong_name_is_told() -> None:
    """Unknown names come with the nearest one, and each kind with what it is instead."""
    store = TypeStore.bundled("jazzy")
    assert "did you mean std_srvs/srv/SetBool?" in error_of(store, "std_srvs/srv/SetBol").what
    assert "did you mean std_srvs/srv/SetBool?" in error_of(store, "srv_std/srv/setbool").what
    assert "std_msgs/msg/String is a message, not a service" in error_of(store, "std_msgs/msg/String").what
    for name in ("std_srvs/SetBol", "std_srvs/SetBool", "std_srvs/srv/SetBool_Reqest"):
        with pytest.raises(MessageTypeError, match=r"did you mean std_srvs/srv/SetBool\?"):
            store[name]
    with pytest.raises(MessageTypeError, match="not a message; its message names end with _Request"):
        store["std_srvs/srv/SetBool"]
    with pytest.raises(MessageTypeError, match="is an action, not a service"):
        store.service("example_interfaces/action/Fibonacci")
    with pytest.raises(MessageTypeError, match="is unknown"):  # ROS 1 has no such services
        TypeStore.bundled("noetic").service("actionlib/action/Test_SendGoal")
    assert store.resolve("std_srvs/SetBool") == "std_srvs/srv/SetBool"
    assert store.resolve("std_msgs/String") == "std_msgs/msg/String"
    assert store.resolve("no_msgs/No") == "no_msgs/msg/No"


def test_ros_1_generates_messages_of_an_action(tmp_path: Path) -> None:
    """A custom action has the messages that actionlib sends, by ROS 1's names."""
    store = custom(
        tmp_path,
        "noetic",
        own_msgs__action__Go="int32 x\n---\n---\nfloat32 part\n",
        own_msgs__action__GoAction="int32 y\n---\n---\n",
    )
    goal = store["own_msgs/GoActionGoal"]
    assert [(field.name, str(field.type)) for field in goal.fields] == [
        ("header", "std_msgs/msg/Header"),
        ("goal_id", "actionlib_msgs/msg/GoalID"),
        ("goal", "own_msgs/msg/GoGoal"),
    ]
    assert store["own_msgs/GoFeedback"].fields == store.action("own_msgs/Go").feedback.fields
    assert [field.name for field in store["own_msgs/GoActionActionGoal"].fields] == [
        "header",
        "goal_id",
        "goal",
    ]
    assert "own_msgs/msg/GoAction" in store and "own_msgs/msg/NoActionGoal" not in store
