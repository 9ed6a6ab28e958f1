"""Builds the native code of matching and curve fitting; nothing is linked but the C library."""

import hashlib
import sys
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext
from setuptools.errors import CCompilerError, CompileError, ExecError, LinkError, PlatformError

NATIVE = Path("src/guide3d/native")


def sources_digest() -> str:
    """Tells at import whether the build is older than the sources beside it; native_library.py computes the same."""
    digest = hashlib.sha256()
    for path in sorted(NATIVE.glob("*.c")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


class BuildNative(build_ext):
    def run(self) -> None:
        try:
            super().run()
        except (CCompilerError, CompileError, ExecError, LinkError, PlatformError, FileNotFoundError) as error:
            sys.exit(
                "guide3d: no working C compiler was found; install one (Debian and Ubuntu: apt install gcc libc6-dev; "
                f"Fedora: dnf install gcc; macOS: xcode-select --install) and install again ({error})"
            )


class PlatformWheel(bdist_wheel):
    """One wheel for every Python of a platform: the native code is called by ctypes and calls nothing of Python's."""

    def get_tag(self) -> tuple[str, str, str]:
        return "py3", "none", super().get_tag()[2]


setup(
    ext_modules=[
        Extension(
            "guide3d._native",
            sources=sorted(str(path) for path in NATIVE.glob("*.c")),
            define_macros=[("GUIDE3D_SOURCES", f'"{sources_digest()}"')],
            # no contraction: the same bits whatever the compiler thinks of fused multiply-add
            extra_compile_args=["-O3", "-std=gnu11", "-ffp-contract=off", "-Wall", "-Wextra"],
            libraries=["m"],
        )
    ],
    cmdclass={"bdist_wheel": PlatformWheel, "build_ext": BuildNative},
)
