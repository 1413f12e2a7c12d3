"""Build the C core; everything else stands in pyproject.toml.

The limited API has buffers from Python 3.11 on, so one abi3 build serves 3.11 and
later, and 3.10 gets a build of its own.
"""

import sys
from pathlib import Path

from setuptools import Extension, setup

ABI3 = sys.version_info >= (3, 11)
SOURCES = ["module.c", "py_channel.c", "py_writer.c", "py_reader.c", "py_plan.c", "py_group.c"]

setup(
    ext_modules=[
        Extension(
            "rosplc._core._native",
            sources=[f"src/rosplc/_core/{name}" for name in SOURCES],
            include_dirs=["src/rosplc/include"],
            depends=sorted(map(str, Path("src/rosplc").glob("**/*.h"))),
            define_macros=[("Py_LIMITED_API", "0x030B0000")] if ABI3 else [],
            extra_compile_args=["-std=gnu11", "-O2", "-Wall", "-Wextra", "-fvisibility=hidden"],
            py_limited_api=ABI3,
        )
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}} if ABI3 else {},
)
