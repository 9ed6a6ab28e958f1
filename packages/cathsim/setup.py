"""Builds the native code against the headers that ship inside the mujoco wheel; nothing is linked."""

import hashlib
import importlib.util
import sys
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext
from setuptools.errors import CCompilerError, CompileError, ExecError, LinkError, PlatformError

NATIVE = Path("src/cathsim/native")


def mujoco_include() -> str:
    spec = importlib.util.find_spec("mujoco")
    if spec is None or spec.origin is None:
        sys.exit("cathsim: building needs the mujoco package (its C headers): pip install 'mujoco>=4.0,<5'")
    return str(Path(spec.origin).parent / "include")


def sources_digest() -> str:
    """Tells at import whether the build is older than the sources beside it; contact/native.py computes the same."""
    digest = hashlib.sha256()
    for path in sorted(NATIVE.glob("*.[ch]")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


class BuildNative(build_ext):
    def run(self) -> None:
        try:
            super().run()
        except (CCompilerError, CompileError, ExecError, LinkError, PlatformError, FileNotFoundError) as error:
            sys.exit(
                "cathsim: no working C compiler was found; install one (Debian and Ubuntu: apt install gcc libc6-dev; "
                f"Fedora: dnf install gcc; macOS: xcode-select --install) and install again ({error})"
            )


class PlatformWheel(bdist_wheel):
    """One wheel for every Python of a platform: the native code is called by ctypes and calls nothing of Python's."""

    def get_tag(self) -> tuple[str, str, str]:
        return "py3", "none", super().get_tag()[2]


setup(
    ext_modules=[
        Extension(
            "cathsim._native",
            sources=sorted(str(path) for path in NATIVE.glob("*.c")),
            depends=sorted(str(path) for path in NATIVE.glob("*.h")),
            include_dirs=[mujoco_include(), str(NATIVE)],
            define_macros=[("CATHSIM_SOURCES", f'"{sources_digest()}"')],
            # no contraction: the same bits whatever the compiler thinks of fused multiply-add; nobody reads errno, and
            # without it square roots are taken several at a time
            extra_compile_args=["-O3", "-std=gnu11", "-ffp-contract=off", "-fno-math-errno", "-Wall", "-Wextra"],
            libraries=["m", "pthread"],
        )
    ],
    cmdclass={"bdist_wheel": PlatformWheel, "build_ext": BuildNative},
)
