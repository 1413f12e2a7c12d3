"""Build what is in C, and shorten the readme for the package index; everything else is in pyproject.toml.

The limited API has buffers from Python 3.11 on, so one abi3 build serves 3.11 and
later, and 3.10 gets a build of its own.
"""

import re
import sys
from pathlib import Path

from setuptools import Extension, setup

ABI3 = sys.version_info >= (3, 11)
CORE = [
    "module.c",
    "py_channel.c",
    "py_writer.c",
    "py_reader.c",
    "py_plan.c",
    "py_group.c",
    "py_sink.c",
    "py_record.c",
    "py_pack.c",
]
EXTENSIONS = {
    "rosplc._core._native": [f"src/rosplc/_core/{name}" for name in CORE],
    "rosplc.ros.dds._batch": ["src/rosplc/ros/dds/batch.c"],
    "rosplc.ros.rospy._tcp": ["src/rosplc/ros/rospy/tcp.c"],
}


def readme() -> str:
    """Return README.md without what the package index cannot show: pictures and links of the repository."""
    text = Path("README.md").read_text(encoding="utf-8")
    text = re.sub(r"(?s)<!--.*?-->\n|!\[[^]]*\]\((?!https?:)[^)]*\)\n\n?", "", text)
    return re.sub(r"\[([^]]*)\]\((?!https?:)[^)]*\)", r"\1", text)


setup(
    long_description=readme(),
    long_description_content_type="text/markdown",
    ext_modules=[
        Extension(
            name,
            sources=sources,
            include_dirs=["src/rosplc/include", "src/rosplc/_core"],
            depends=sorted(map(str, Path("src/rosplc").glob("**/*.h"))),
            define_macros=[("Py_LIMITED_API", "0x030B0000")] if ABI3 else [],
            extra_compile_args=["-std=gnu11", "-O2", "-Wall", "-Wextra", "-fvisibility=hidden"],
            py_limited_api=ABI3,
        )
        for name, sources in EXTENSIONS.items()
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}} if ABI3 else {},
)
